"""Recordings and the packages of their devices: the one that is missing is named."""

import csv
import json
import shutil
import sys

import pytest
from mcap.reader import make_reader

from hil.report.hover_data import taken_out
from hil.report.page_figures import themed_svg

TWIN = """
from typing import Literal

from hil.config.imu import Bno055Config
from hil.drivers.imu.bno055.model import Bno055


class Config(Bno055Config):
    model: Literal["twin"] = "twin"


class Twin(Bno055):
    name, title, config, probe_bauds = "twin", "a twin", Config, ()


MODEL = Twin
"""
TABLES = """
schema = 1
name = "lab"

[environment]
surface = "floor"
tilt_rad = 0.0

[servos]
backend = "emulated"

[imu]
backend = "emulated"
"""
STAND = """
from hil.procedure import procedure


@procedure(name="stand", needs=("servos", "imu"))
def run(ctx):
    with ctx.step("look"):
        ctx.bench.observe(0.5)
"""


@pytest.fixture
def stand(tmp_path):
    """A bench without anything that is added, and a procedure that looks at it."""
    (tmp_path / "bench.toml").write_text(TABLES)
    (tmp_path / "stand.py").write_text(STAND)


def topics(recording):
    with recording.open("rb") as file:
        summary = make_reader(file).get_summary()
        return {channel.topic for channel in summary.channels.values()}


def test_a_recording_repeats_is_exported_and_drawn_with_its_package(climb, rangefinder, hil, tmp_path):
    recording = climb / "recording.mcap"
    assert hil("replay", recording, "--verify", packages=[rangefinder]).code == 0
    done = hil("export", recording, "--out", "table.csv", packages=[rangefinder])
    assert done.code == 0, done.said
    with (tmp_path / "table.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) > 60
    assert 0.1 < float(rows[-1]["rangefinder_distance_m"]) < 3.0
    assert 0.0 <= float(rows[-1]["t"]) - float(rows[-1]["rangefinder_t"]) < 0.1
    assert "/range" in topics(recording)


@pytest.mark.parametrize(
    "words",
    [
        ("replay", "{}"),
        ("replay", "{}", "--verify"),
        ("replay", "{}", "--rerun", "x.rrd"),
        ("export", "{}"),
        ("tune", "{}"),
        ("doctor", "--bench", "replay.toml"),
    ],
    ids=" ".join,
)
def test_without_the_package_every_command_names_it(words, climb, hil, tmp_path):
    recording = tmp_path / "climb_1.mcap"
    shutil.copy(climb / "recording.mcap", recording)
    (tmp_path / "replay.toml").write_text(f'{TABLES}\n[emulation]\nreplay = "{recording}"\n')
    done = hil(*(word.format(recording) for word in words))
    assert done.code == 2, done.out + done.said
    assert "rangefinder (hil-rangefinder 0.1.0)" in done.said
    assert "install hil-rangefinder 0.1.0 from where you got it" in done.said
    assert not {path.name for path in tmp_path.iterdir()} - {recording.name, "replay.toml"}


def test_the_page_draws_what_the_device_has_measured(climb, rangefinder, hil, tmp_path):
    hil("export", climb / "recording.mcap", "--out", "table.csv", packages=[rangefinder])
    with (tmp_path / "table.csv").open() as file:
        rows = [row["rangefinder_distance_m"] for row in csv.DictReader(file)]
    distances = [float(text) for text in rows if text]
    figures = json.loads((climb / "result.json").read_text())["figures"]
    (drawn,) = (climb / f["path"] for f in figures if f["title"] == "Range finder")
    axes, _ = json.loads(taken_out(themed_svg(drawn))[1])["axes"]
    assert "(m)" in axes["y"]["label"]
    (series,) = axes["series"]
    known = [v for v in series["y"] if v is not None]
    assert len(known) > 10
    assert min(distances) - 1e-4 <= min(known) <= max(known) <= max(distances) + 1e-4


def test_the_report_of_a_run_is_read_without_the_package(climb, hil):
    assert hil("report", climb).code == 0


def test_a_recording_of_a_bench_without_the_device_needs_no_package(rangefinder, stand, hil, tmp_path):
    assert hil("run", "stand.py", "--bench", "bench.toml", "--out", "out", packages=[rangefinder]).code == 0
    recording = tmp_path / "out" / "recording.mcap"
    assert "/range" not in topics(recording)
    for words in (("replay", recording, "--verify"), ("export", recording), ("report", "out")):
        done = hil(*words)
        assert done.code == 0, done.said


def test_a_recording_of_a_model_that_is_absent_names_its_package(package, stand, hil, tmp_path):
    (tmp_path / "bench.toml").write_text(TABLES + 'model = "twin"\n')
    folder = package("hil-twin", TWIN, "MODEL")
    assert hil("run", "stand.py", "--bench", "bench.toml", "--out", "out", packages=[folder]).code == 0
    recording = tmp_path / "out" / "recording.mcap"
    assert hil("replay", recording, "--verify", packages=[folder]).code == 0
    done = hil("replay", recording, "--verify")
    assert done.code == 2
    assert "imu.twin (hil-twin 1.0)" in done.said
    assert "install hil-twin 1.0 from where you got it" in done.said


def test_a_package_that_renamed_a_key_is_named_with_both_versions(package, stand, hil, tmp_path):
    source = TWIN.replace('= "twin"\n', '= "twin"\n    old_key: float = 1.0\n', 1)
    (tmp_path / "bench.toml").write_text(TABLES + 'model = "twin"\nold_key = 2.0\n')
    folder = package("hil-twin", source, "MODEL")
    assert hil("run", "stand.py", "--bench", "bench.toml", "--out", "out", packages=[folder]).code == 0
    shutil.rmtree(folder)
    sys.modules.pop("hil_twin", None)
    newer = package("hil-twin", source.replace("old_key", "new_key"), "MODEL", version="2.0")
    done = hil("replay", tmp_path / "out" / "recording.mcap", packages=[newer])
    assert done.code == 2
    assert "imu.old_key: unknown key" in done.said
    assert "recorded with hil-twin 1.0, installed is hil-twin 2.0" in done.said
