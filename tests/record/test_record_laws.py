"""The record of a robot: what is written is read, a kill leaves a whole version, bad input is named."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from pydantic import TypeAdapter

from hil.bench import open_bench
from hil.bench.doctor.robot_record_import import import_record
from hil.cli import main
from hil.config.estimator import EstimatorConfig
from hil.config.field_types import UnitQuaternion
from hil.config.loading import load_bench
from hil.config.robot_record import Figure, NewPart, Part, RobotRecord
from hil.config.robot_record.overlay import identity
from hil.core.errors import ConfigError
from hil.procedure import BenchSource

WALL = load_bench("emulated")
ROBOT = identity(WALL)
ZEROS = {"alignment.steer_zero_rad": [0.01, -0.02, 0.03, -0.04]}
SCALE = {"tracker.scale": 1.004, "tracker.scale_sigma": 0.001}


def part(values=None, **facts):
    given = {
        "procedure": "a_test",
        "verdict": "PASS",
        "measured": "2026-11-22T10:00:00+00:00",
        "bench": "emulated",
    }
    return NewPart(Part(**{**given, "values": values or {}, **facts}))


def add(record, robot=ROBOT, **parts):
    return record.add(parts, robot, created="2026-11-22T12:00:00+00:00", why="a test")


def load(record, **settings):
    return load_bench("emulated", overrides={"record.folder": str(record.folder), **settings})


@pytest.fixture
def record(tmp_path):
    found = RobotRecord(tmp_path / "robot")
    add(found, zeros=part(ZEROS), camera=part(SCALE, figures={"scale": Figure(value=1.004, sigma=0.0005)}))
    return found


def test_what_was_added_is_read_again_and_counts_on_the_bench(record):
    file = record.read()
    assert (file.version, sorted(file.parts)) == (1, ["camera", "zeros"])
    assert file.parts["camera"].figures["scale"] == Figure(value=1.004, sigma=0.0005)
    config = load(record)
    assert config.alignment.steer_zero_rad == (0.01, -0.02, 0.03, -0.04)
    assert config.tracker.scale == 1.004
    assert load(record, **{"tracker.scale": 1.1}).tracker.scale == 1.1


def test_a_part_that_is_left_out_is_not_applied(record):
    config = load(record, **{"record.without": ["camera"]})
    assert (config.tracker.scale, config.alignment.steer_zero_rad[0]) == (1.0, 0.01)
    with pytest.raises(ConfigError, match=r"kamera: no such part.*camera"):
        load(record, **{"record.without": ["kamera"]})


def test_the_mount_that_is_believed_changes_and_the_true_one_of_an_emulated_camera_does_not(record):
    before = load(record).tracker.mount_position_m
    add(record, camera=part({"tracker.mount_position_m": [0.2, 0.0, 0.0666]}))
    config = load(record)
    assert config.tracker.mount_position_m == (0.2, 0.0, 0.0666)
    assert tuple(config.emulation.tracker["mount_position_m"]) == before


def test_a_version_can_be_taken_back_and_forth(record):
    add(record, camera=part({"tracker.scale": 0.99}))
    assert load(record).tracker.scale == 0.99
    assert record.rollback().file.version == 1
    assert load(record).tracker.scale == 1.004
    record.apply(2)
    assert load(record).tracker.scale == 0.99
    record.rollback()
    with pytest.raises(ConfigError, match="no earlier version"):
        record.rollback()
    add(record, camera=part({"tracker.scale": 1.01}))
    assert [v.file.version for v in record.history().versions] == [1, 2, 3]


def test_what_was_measured_on_top_of_other_zeros_goes_with_them(record, tmp_path):
    (tmp_path / "calibration.toml").write_text("# any")
    fitted = NewPart(part().part, {"calibration": tmp_path / "calibration.toml"})
    add(record, geometry=fitted, slip=part({"estimator.wall.creep": 0.001}))
    assert add(record, camera=part(SCALE)) == ()
    assert add(record, zeros=part(ZEROS)) == ()
    gone = add(record, zeros=part({"alignment.steer_zero_rad": [0.0] * 4}))
    assert sorted(gone) == ["geometry", "slip"]
    assert sorted(record.read().parts) == ["camera", "zeros"]


class Struck(BaseException):
    """The process ends here."""


def test_a_process_struck_at_any_write_leaves_the_old_version_or_the_new_one(record, tmp_path, monkeypatch):
    """Every flush and every rename of a transaction is the last thing that happens, in turn."""
    (tmp_path / "calibration.toml").write_text("# any")
    fitted = NewPart(part().part, {"calibration": tmp_path / "calibration.toml"})
    for strike in range(1, 100):
        copy = RobotRecord(tmp_path / f"copy{strike}")
        shutil.copytree(record.folder, copy.folder)
        calls = 0

        def struck(real, at=strike):
            def call(*arguments):
                nonlocal calls
                calls += 1
                if calls == at:
                    raise Struck
                return real(*arguments)

            return call

        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", struck(os.fsync))
            patch.setattr(os, "replace", struck(os.replace))
            try:
                add(copy, geometry=fitted)
            except Struck:
                ended = False
            else:
                ended = True
        known = set(copy.read().parts)
        assert known in ({"zeros", "camera"}, {"zeros", "camera", "geometry"})
        assert not ended or "geometry" in known
        add(copy, camera=part({"tracker.scale": 1.02}))
        assert copy.read().parts["camera"].values["tracker.scale"] == 1.02
        if ended:
            break
    assert strike > 8


def test_processes_that_add_at_the_same_time_lose_nothing_of_each_other(record):
    children = []
    for k in range(4):
        child = os.fork()
        if child == 0:
            try:
                for n in range(5):
                    add(record, camera=part({"tracker.scale": 1.0 + 0.01 * k + 0.001 * n}))
                os._exit(0)
            finally:
                os._exit(1)
        children.append(child)
    assert [os.waitpid(child, 0)[1] for child in children] == [0] * 4
    assert [v.file.version for v in record.history().versions] == list(range(1, 22))
    assert sorted(record.read().parts) == ["camera", "zeros"]


def test_a_half_written_version_is_named_and_the_one_before_it_can_be_put_back(record):
    add(record, camera=part({"tracker.scale": 0.99}))
    text = record.path.read_text()
    record.path.write_text(text[: len(text) // 2])
    with pytest.raises(ConfigError, match="rollback"):
        load(record)
    assert record.history().damaged
    record.rollback(1)
    assert load(record).tracker.scale == 1.004


def test_a_version_changed_by_hand_is_refused(record):
    record.path.write_text(record.path.read_text().replace("1.004", "1.005"))
    with pytest.raises(ConfigError, match="changed by hand"):
        load(record)


def test_the_record_of_another_robot_is_refused_with_all_that_differs(record):
    other = {"servos.model_number": 1020, "robot.name": "the other one", "robot.supply_v": 12.0}
    with pytest.raises(ConfigError, match="another robot") as caught:
        load(record, **other)
    assert "servos.model_number: 1010 in the record, 1020 here" in str(caught.value)
    assert "robot.name: 'emulated' in the record, 'the other one' here" in str(caught.value)
    with pytest.raises(ConfigError, match="another robot"):
        add(record, robot=identity(load_bench("emulated", overrides={"robot.name": "b"})), camera=part(SCALE))
    assert record.read().version == 1


def test_an_emulated_robot_of_another_seed_is_another_robot(record):
    """Wheels, zeros and camera of an emulated robot are drawn by the seed of its world."""
    source = BenchSource("emulated", seed=1, overrides={"record.folder": str(record.folder)})
    assert source.config.tracker.scale == 1.004  # of a record that does not say whose it is
    add(record, robot=identity(WALL, 1), camera=part(SCALE))
    assert source.config.tracker.scale == 1.004
    for other in ({"seed": 2}, {"overrides": {"emulation.plant": "mujoco"}}):
        with pytest.raises(ConfigError, match=r"(?s)another robot.*'emulated, of seed 1 in plant own'"):
            _ = source.changed(**other).config
    with pytest.raises(ConfigError, match="'real' here"):
        _ = source.changed(overrides={"servos.backend": "real", "servos.port": "/dev/ttyUSB0"}).config
    with pytest.raises(ConfigError, match="another robot"):
        open_bench("emulated", seed=2, overrides=source.overrides)
    with pytest.raises(ConfigError, match="another robot"):
        add(record, robot=identity(WALL, 2), camera=part(SCALE))
    add(record, camera=part(SCALE))
    assert record.read().robot.body == "emulated, of seed 1 in plant own"


def test_a_part_past_its_validity_is_named_with_how_to_measure_it_again(record):
    add(record, camera=part(SCALE, until="2026-01-01"))
    with pytest.raises(ConfigError, match=r"camera: .*valid until 2026-01-01.*hil run tracker_extrinsics"):
        load(record)
    assert load(record, **{"record.without": "camera"}).alignment.steer_zero_rad[0] == 0.01


def test_slip_of_another_wall_is_refused_and_on_a_floor_it_does_not_count(record):
    add(record, slip=part({"estimator.wall.creep": 0.001}, surface="concrete"))
    with pytest.raises(ConfigError, match="slip: measured on concrete, the bench stands on melamine"):
        load(record)
    assert load(record, **{"environment.surface": "concrete"}).estimator.wall.creep == 0.001
    floor = {"environment.surface": "floor", "environment.tilt_rad": 0.0}
    assert load(record, **floor).estimator.wall.creep == 0.05


def test_parts_that_do_not_belong_together_are_named(record):
    file = record.read()
    other = file.parts["zeros"].model_copy(update={"made_with": {"signs": "0" * 64}})
    wrong = file.model_copy(update={"parts": {**file.parts, "zeros": other}})
    record.path.write_bytes(record._write(wrong.model_copy(update={"version": 2})).read_bytes())
    with pytest.raises(ConfigError, match=r"zeros: measured .* with other signs which is gone"):
        load(record)


def test_a_file_that_was_changed_after_it_was_measured_is_named(record, tmp_path):
    offsets = tmp_path / "imu_offsets.toml"
    offsets.write_text("a = 1\n")
    add(record, inertial=NewPart(part().part, {"imu.calibration_file": offsets}))
    path = load(record).imu.calibration_file
    assert Path(path).read_text() == "a = 1\n"
    offsets.write_text("a = 2\n")
    assert Path(path).read_text() == "a = 1\n"
    Path(path).write_text("a = 3\n")
    with pytest.raises(ConfigError, match=r"inertial: .*was changed after it was measured"):
        load(record)


def test_a_part_that_holds_keys_of_another_is_refused(record):
    with pytest.raises(ValueError, match=r"holds tracker.scale, which belongs to camera"):
        add(record, zeros=part(SCALE))


def test_the_record_of_another_emulated_robot_gives_no_parts(tmp_path, record):
    """The bench names no seed, so that the two records are held against each other."""
    mine, other = RobotRecord(tmp_path / "mine"), RobotRecord(tmp_path / "other")
    for kept, seed in ((mine, 3), (other, 4)):
        add(kept, robot=identity(WALL, seed), zeros=part(ZEROS))
    with pytest.raises(ConfigError, match="another robot") as raised:
        import_record(mine, other.folder, WALL, "2026-11-22T13:00:00+00:00")
    assert "of seed 4" in str(raised.value)
    assert mine.read().version == 1


def test_a_rotation_is_the_same_however_often_it_is_read():
    """A record keeps six digits of it, which are not of norm 1; a run that is resumed reads its own again."""
    rotation = TypeAdapter(UnitQuaternion).validate_python
    for turn in np.random.default_rng(1).normal(scale=0.05, size=(300, 3)):
        true = np.array([1.0, *turn])
        once = rotation(np.round(true / np.linalg.norm(true), 6).tolist())
        assert rotation(once) == once


def test_the_commands_show_compare_and_roll_back(record, capsys):
    add(record, camera=part({"tracker.scale": 0.99}, figures={"scale": Figure(value=0.99, sigma=0.0005)}))
    folder = str(record.folder)
    assert main(["robot", "show", folder]) == 0
    shown = capsys.readouterr().out
    assert "scale" in shown
    assert "slip        not known: hil run surface_identification" in shown
    assert main(["robot", "diff", folder]) == 0
    assert "1.00400 ± 0.00050 -> 0.99000 ± 0.00050  (-19.8 sigma)" in capsys.readouterr().out
    assert main(["robot", "rollback", folder]) == 0
    assert load(record).tracker.scale == 1.004
    assert main(["robot", "apply", folder]) == 2
    assert main(["robot", "show", folder, "--page", str(record.path)]) == 2
    assert "is no name for it; expected one that ends with .html" in capsys.readouterr().err
    assert record.read().version == 1
    for words in (["show"], ["rollback"], ["apply", "--version", "1"]):
        assert main(["robot", *words, folder + "_gone"]) == 2
        assert "no record of a robot there" in capsys.readouterr().err


def test_a_bench_opens_with_what_the_record_knows(record):
    bench = open_bench("emulated", overrides={"record.folder": str(record.folder)})
    assert bench.model.alignment_parameters.tracker_scale == 1.004
    assert bench.config.estimator.tracker.scale_sigma == 0.001
    bench.close()


NOISE = {"estimator.gyro.rate_rad_s": 0.0011, "estimator.process.acceleration_m_s2_sqrt_hz": 0.021}


def test_noise_of_the_record_counts_above_defaults_and_below_what_the_bench_file_says(tmp_path):
    record = RobotRecord(tmp_path / "robot")
    bench = load_bench("emulated_delivered")
    add(record, identity(bench), noise=part(NOISE))
    folder = {"record.folder": str(record.folder)}
    config = load_bench("emulated_delivered", overrides=folder)
    assert config.estimator.gyro.rate_rad_s == 0.0011
    assert config.estimator.process.acceleration_m_s2_sqrt_hz == 0.021
    assert config.estimator.tracker.position_m == bench.estimator.tracker.position_m
    said = load_bench("emulated_delivered", overrides={**folder, "estimator.gyro.rate_rad_s": 0.005})
    assert said.estimator.gyro.rate_rad_s == 0.005
    assert (
        load_bench("emulated", overrides={**folder, "name": bench.name}).estimator.gyro == WALL.estimator.gyro
    )
    paper = load_bench("emulated_delivered", overrides={**folder, "estimator.preset": "paper"})
    assert paper.estimator.gyro.rate_rad_s == EstimatorConfig().gyro.rate_rad_s
