"""Recordings and journals of version 0.1 are read, replayed and resumed with their own configuration."""

import json
import math
from pathlib import Path

import pytest

import hil
from hil.config.loading import load_bench
from hil.config.recorded import changed_since, recorded_bench
from hil.recording.mcap_writer import McapRecorder
from hil.replay.recordings import open_recording
from hil.replay.verification import verify_run
from hil.robot.trajectories import line

HERE = Path(__file__).parent


def of_0_1(name):
    """Configuration as version 0.1 wrote it into the recordings of a shipped profile."""
    return json.loads((HERE / f"{name}_0_1.json").read_text())


def in_the_old_form(config):
    """A configuration of today as version 0.1 would have written it."""
    tree = dict(config)
    environment = dict(tree.pop("environment"))
    environment.pop("friction", None)
    area = {key: environment.pop(key) for key in ("x_range_m", "y_range_m") if key in environment}
    tree["safety"] = {**tree["safety"], **area}
    tree["surface"] = "floor" if environment["tilt_rad"] == 0.0 else "wall"
    return {**tree, "emulation": {**tree["emulation"], **environment}}


def test_the_configuration_of_an_old_recording_is_read_as_it_was():
    wall = recorded_bench(of_0_1("emulated"), "old.mcap")
    assert wall.environment.model_dump() == {
        "surface": "melamine", "tilt_rad": math.pi / 2.0, "start_pose": (0.1, 0.2, 0.05),
        "friction": None, "x_range_m": (-1.0, 5.0), "y_range_m": (-2.0, 4.0),
    }  # fmt: skip
    assert (wall.environment.kind, wall.servos.watchdog_s) == ("wall", 0.2)
    floor = recorded_bench(of_0_1("emulated_floor"), "old.mcap")
    assert (floor.environment.surface, floor.environment.kind) == ("floor", "floor")


@pytest.mark.parametrize(("surface", "tilt_rad"), [("floor", math.pi / 2.0), ("wall", 0.0)])
def test_where_old_keys_contradict_each_other_the_guards_of_then_count(surface, tilt_rad):
    tree = {**of_0_1("emulated"), "surface": surface}
    tree["emulation"] |= {"tilt_rad": tilt_rad}
    assert recorded_bench(tree, "old.mcap").environment.kind == surface


@pytest.mark.parametrize("profile", ["emulated", "emulated_floor"])
def test_a_recording_with_an_old_header_repeats_bit_for_bit(tmp_path, profile):
    path, start = tmp_path / "old.mcap", (0.1, 0.2, 0.05)
    bench = hil.open_bench(profile, seed=4, start_pose=start)
    header = bench.header()
    header["config"] = in_the_old_form(header["config"])
    bench.add_sink(McapRecorder(path, header, lossless=True))
    with bench:
        bench.drive(line(start, (0.12, 0.2, 0.05), duration_s=1.0), hold_s=0.2)
    opened = open_recording(path)
    assert opened.bench.config == recorded_bench(header["config"], "header")
    assert opened.bench.config.environment == bench.config.environment
    told = [verify_run(opened.bench, run) for run in opened.runs]
    assert [r["difference"] for r in told] == [None, None]


def test_what_has_changed_since_is_named_by_its_key():
    now = load_bench("emulated")
    assert changed_since(now.model_dump(mode="json", by_alias=True), now) == []
    assert changed_since(in_the_old_form(now.model_dump(mode="json", by_alias=True)), now) == []
    other = load_bench("emulated", overrides={"environment.tilt_rad": 1.5, "imu": None})
    assert changed_since(now.model_dump(mode="json", by_alias=True), other) == ["environment.tilt_rad", "imu"]
