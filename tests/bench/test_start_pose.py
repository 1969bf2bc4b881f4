"""A real robot that no motion capture sees has to be given where it stands."""

import contextlib
import math
import sys

import numpy as np
import pytest
from click.testing import CliRunner

import hil
from hil.cli import main, start_question
from hil.config.loading import load_bench
from hil.core.errors import ConfigError, SafetyStop, UsageError
from hil.robot.trajectories import line

REAL = 'schema = 1\nname = "blind"\n[servos]\nport = "/dev/no-such-port"\n[imu]\nbackend = "emulated"\n'
WALL = """
schema = 1
name = "wall"
[environment]
start_pose = [0.0, 0.0, 90.0]
[servos]
backend = "emulated"
"""
STRAIGHT = line((0.0, 0.0, 0.0), (0.05, 0.0, 0.0), duration_s=2.0)


@pytest.fixture
def blind(tmp_path):
    path = tmp_path / "blind.toml"
    path.write_text(REAL)
    return path


def test_where_the_robot_stands_is_known_or_not(blind):
    def known(*, emulate=None, **overrides):
        return load_bench(blind, emulate=emulate, overrides=overrides).knows_start

    assert not known()
    assert not known(mocap={"backend": "emulated"}), "emulated cameras do not see a real robot"
    assert known(mocap={})
    assert known(emulate="servos")
    assert known(servos=None)
    assert known(environment={"start_pose": [0.0, 0.0, 0.0]})
    assert not known(environment={"tilt_rad": 1.5})


def test_a_drive_of_a_robot_that_may_be_anywhere_is_refused_before_anything_moves(blind):
    bench = hil.open_bench(blind)
    try:
        with pytest.raises(ConfigError, match=r"blind: the start pose is unknown.*--start.*start_pose"):
            bench.drive(STRAIGHT)
        with pytest.raises(ConfigError, match="the start pose is unknown"):
            bench.measured_pose(np.zeros((3, 3)))
    finally:
        bench.close()


def test_cameras_that_see_nothing_are_no_reason_to_believe_in_the_origin(blind):
    seen = load_bench(blind, overrides={"mocap": {}})
    bench = hil.open_bench(seen, overrides={"imu": None})
    nothing = np.full((5, 3), np.nan)
    with pytest.raises(ConfigError, match="motion capture has not seen the robot"):
        bench.measured_pose(nothing)
    np.testing.assert_allclose(bench.measured_pose(np.ones((5, 3))), 1.0)
    reported = hil.open_bench(seen, overrides={"imu": None}, start_pose=(0.5, 1.0, 0.1))
    np.testing.assert_allclose(reported.measured_pose(nothing), (0.5, 1.0, 0.1))


@pytest.mark.parametrize("command", [("run", "bring_up"), ("live",)])
def test_the_command_line_refuses_without_a_terminal(blind, tmp_path, command, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main([*command, "--bench", str(blind)]) == 2
    assert "the start pose is unknown" in capsys.readouterr().err
    assert main([*command, "--start", "1,2"]) == 2
    assert "x,y,theta: m, m, rad" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "pose"),
    [
        ("1,2,0.5", (1.0, 2.0, 0.5)),
        (" -0.1, 0 ,90deg", (-0.1, 0.0, math.pi / 2.0)),
        ("0,0,-15 deg", (0.0, 0.0, -math.pi / 12.0)),
    ],
)
def test_a_start_is_metres_and_radians_or_degrees(text, pose):
    assert start_question.parse_start(text) == pytest.approx(pose)


@pytest.mark.parametrize("text", ["", "1,2", "1,2,nan", "1,2,deg"])
def test_what_is_no_start_names_how_it_is_written(text):
    with pytest.raises(UsageError, match="x,y,theta: m, m, rad"):
        start_question.parse_start(text)


def test_at_a_terminal_it_is_asked_until_it_is_answered(blind, monkeypatch):
    runner, config = CliRunner(), load_bench(blind)
    with runner.isolation(input="there\n0.5,1,0\n") as (_, err, *_rest):
        monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
        assert start_question.asked_start(config) == {start_question.KEY: (0.5, 1.0, 0.0)}
        asked = err.getvalue().decode()
    assert asked.count("blind: where does the robot stand? (x,y,theta: m, m, rad") == 2
    assert start_question.asked_start(load_bench("emulated")) == {}


@pytest.mark.parametrize("words", [["doctor"], ["run", "bring_up", "--dry-run"]])
def test_degrees_in_place_of_radians_are_refused_before_anything_opens(words, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = ["--start", "0,0,90"]
    if words == ["doctor"]:
        (tmp_path / "bench.toml").write_text(WALL)
        given = ["--bench", "bench.toml"]
    assert main([*words, *given]) == 2
    said = capsys.readouterr().err
    assert "environment.start_pose" in said
    assert "angles are in radians" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("profile", "heading_rad"), [("emulated", -0.26), ("emulated", 2 * math.pi), ("emulated_floor", 1.57)]
)
def test_on_a_wall_a_heading_is_within_a_limit_and_on_the_floor_it_is_any(profile, heading_rad):
    assert load_bench(profile, overrides={"environment.start_pose": (0.0, 0.0, heading_rad)})


@pytest.mark.parametrize("offset_m", [0.05, -0.1, 0.0])
@pytest.mark.parametrize("feedback", ["odometry", "ekf"])
def test_motion_capture_that_sees_the_robot_elsewhere_than_was_said_is_reported(offset_m, feedback):
    faults = (f"mocap:wrong@0,offset_m={offset_m}",) if offset_m else ()
    settings = {"loop.rate_hz": 50.0, "emulation.mocap.position_noise_m": 0.0006}
    bench = hil.open_bench("emulated", seed=3, faults=faults, overrides=settings)
    with bench, contextlib.suppress(SafetyStop):
        bench.drive(line((0, 0, 0), (0.04, 0, 0)), start_pose=np.zeros(3), feedback=feedback, hold_s=0.1)
    said = [text for text in bench.warnings if "start_pose" in text]
    assert len(said) == bool(offset_m)
    assert not said or f"{abs(1e3 * offset_m):.0f} mm" in said[0]
