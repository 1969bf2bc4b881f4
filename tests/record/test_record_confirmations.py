"""The record keeps what measurements have confirmed of the bench file, for as long as the value stays."""

import json
from pathlib import Path

import pytest

from hil.bench.cross_checks.parameters import Parameters
from hil.cli import main
from hil.config import profiles
from hil.config.loading import load_bench
from hil.config.robot_record import Confirmation, NewPart, Part, RobotRecord
from hil.config.robot_record.overlay import identity
from hil.core.cross_check import CrossCheck

WHEN = "2026-11-22T10:00:00+00:00"
MASS = Confirmation(
    value=3.25, by="the work of the drives", procedure="wall_tracking", measured=WHEN, difference=0.02
)
RADII = Confirmation(value=[0.0254] * 4, by="small motions", procedure="bring_up", measured=WHEN)


@pytest.fixture
def record(tmp_path):
    found = RobotRecord(tmp_path / "robot")
    confirm(found, {"robot.mass_kg": MASS, "robot.wheel_radius_m": RADII})
    return found


def confirm(record, confirmed, contradicted=None, parts=None):
    robot = identity(load_bench("emulated"))
    given = {"confirmed": confirmed, "contradicted": contradicted}
    return record.add(parts or {}, robot, created=WHEN, why="a test", **given)


def rows(record, **settings):
    config = load_bench("emulated", overrides={"record.folder": str(record.folder), **settings})
    return {row.key: row for row in Parameters(config).rows()}


def test_a_value_that_was_confirmed_is_so_in_later_sessions_with_its_date(record):
    found = rows(record)
    mass, radii = found["robot.mass_kg"], found["robot.wheel_radius_m"]
    assert (mass.state, mass.by, mass.on) == ("confirmed", "the work of the drives", "2026-11-22")
    assert mass.difference == 0.02
    assert (radii.state, radii.value) == ("confirmed", (0.0254,) * 4)
    assert found["robot.wheel_x_m"].state == "unconfirmed"


@pytest.mark.parametrize(("key", "value"), [("robot.mass_kg", 3.3), ("thrust.full_force_n", 30.0)])
def test_another_value_is_not_confirmed_and_that_of_another_key_stays(record, key, value):
    found = rows(record, **{key: value})
    assert found[key].state == "unconfirmed"
    assert (found["robot.mass_kg"].state == "confirmed") == (key != "robot.mass_kg")


def test_what_was_contradicted_is_confirmed_no_longer(record):
    confirm(record, {}, {"robot.mass_kg": 2.0})
    assert rows(record)["robot.mass_kg"].state == "confirmed", "another value was contradicted"
    confirm(record, {}, {"robot.mass_kg": 3.25})
    assert rows(record)["robot.mass_kg"].state == "unconfirmed"


def test_a_measurement_of_now_counts_before_that_of_the_record(record):
    config = load_bench("emulated", overrides={"record.folder": str(record.folder)})
    parameters = Parameters(config)
    for state in ("confirmed", "contradicted"):
        parameters.take([CrossCheck("robot.mass_kg", 3.25, state, "a test", text="robot.mass_kg")])
        row = {row.key: row for row in parameters.rows()}["robot.mass_kg"]
        assert (row.state, row.by, row.on) == (state, "a test", "")


def test_only_what_is_new_makes_a_version(record):
    later = MASS.model_copy(update={"measured": "2026-11-23T10:00:00+00:00", "difference": 0.01})
    confirm(record, {"robot.mass_kg": later})
    assert record.read().version == 1
    confirm(record, {"robot.mass_kg": later.model_copy(update={"value": 3.3})})
    assert record.read().version == 2
    assert rows(record, **{"robot.mass_kg": 3.3})["robot.mass_kg"].on == "2026-11-23"
    record.rollback()
    assert rows(record)["robot.mass_kg"].on == "2026-11-22"


def test_a_value_that_a_procedure_has_found_is_confirmed_by_it(record):
    part = Part(
        procedure="tracker_extrinsics",
        verdict="PASS",
        measured=WHEN,
        bench="emulated",
        values={"tracker.scale": 1.01},
    )
    confirm(record, {}, parts={"camera": NewPart(part)})
    row = rows(record)["tracker.scale"]
    assert (row.value, row.state, row.by, row.on) == (1.01, "confirmed", "tracker_extrinsics", "2026-11-22")
    assert rows(record, **{"tracker.scale": 1.0})["tracker.scale"].state == "unconfirmed"
    assert rows(record, **{"record.without": ["camera"]})["tracker.scale"].state == "unconfirmed"


def test_the_doctor_tells_when_a_value_was_confirmed(record, tmp_path, capsys):
    text = (Path(profiles.__file__).parent / "emulated.toml").read_text()
    bench = tmp_path / "bench.toml"
    bench.write_text(f'{text}\n[record]\nfolder = "{record.folder}"\n')
    assert main(["doctor", "--bench", str(bench), "--watch", "0.3"]) == 0
    (line,) = (one for one in capsys.readouterr().out.splitlines() if "robot.mass_kg" in one)
    assert line.startswith("confirmed")
    assert "the work of the drives, on 2026-11-22" in line


def test_the_record_shows_and_compares_what_was_confirmed(record, tmp_path, capsys):
    confirm(record, {}, {"robot.mass_kg": 3.25})
    assert main(["robot", "show", str(record.folder), "--version", "1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["confirmed"]["robot.mass_kg"]["procedure"] == "wall_tracking"
    assert main(["robot", "diff", str(record.folder), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["differences"]
    assert (row["name"], row["new"]) == ("robot.mass_kg", "by nothing")
    page = tmp_path / "robot.html"
    assert main(["robot", "show", str(record.folder), "--page", str(page)]) == 0
    assert "robot.wheel_radius_m" in page.read_text()
