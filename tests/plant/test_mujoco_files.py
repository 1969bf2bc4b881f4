"""A robot from the user's own MJCF: what it is, and what is wrong with a file that is no such robot."""

import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from mujoco_driving import robot, truth
from plant_driving import drive, settle, wait

from hil.config.robot import RobotConfig
from hil.core.errors import ConfigError
from hil.fakes.mujoco_plant import mjcf
from hil.fakes.mujoco_plant.mjcf import describe_robot

PLAIN = describe_robot(truth("melamine", math.pi / 2))


@pytest.fixture
def written(tmp_path):
    """A function that writes a changed description and returns its path."""

    def write(*changes):
        text = PLAIN
        for pattern, new in changes:
            text, count = re.subn(pattern, new, text)
            assert count >= 1, pattern
        path = tmp_path / "mine.xml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


TIMESTEP = (r"<worldbody>", '<option timestep="0.001"/>\n<worldbody>')


def test_the_generated_description_in_a_file_is_the_same_robot(written):
    paths = []
    for plant in (robot(), robot(mjcf=written(TIMESTEP))):
        settle(plant)
        drive(plant, 3.0, 0.2)
        wait(plant, 0.5)
        paths.append(plant.truth().pose_body_in_wall)
    np.testing.assert_array_equal(*paths)


def test_masses_and_wheels_are_those_of_the_file(written):
    heavy = written(
        TIMESTEP,
        (r' mass="2\.99"', ' mass="4.5"'),
        (r"ellipsoid\" size=\"0.0254 0.012 0.0254", 'ellipsoid" size="0.03 0.012 0.03'),
    )
    plant = robot(mjcf=heavy)
    assert plant.parameters.mass_kg == pytest.approx(4.5 + 8 * 0.0325)
    assert plant.parameters.wheel_radius_m[0] == pytest.approx(0.03, abs=2e-4)


WRONG = {
    "a joint that is missing": (
        (r"steer_BL", "stear_BL"),
        "joint steer_BL is missing; did you mean stear_BL?",
    ),
    "a fifth wheel": (
        (
            r"</body>\n  </worldbody>",
            '<body><joint name="drive_ML" axis="0 1 0"/><geom size="0.02"/></body></body></worldbody>',
        ),
        "joints beside the eight of four wheels: drive_ML",
    ),
    "no free joint": ((r"<freejoint/>", ""), "0 free joints; expected one"),
    "two wheels swapped": (
        ((r"_FL", "_XX"), (r"_BR", "_FL"), (r"_XX", "_BR")),
        r"wheel FL stands at x = -0\.1125, y = -0\.1125 m; .* that is the place of BR",
    ),
    "a cylinder that lies flat": (
        (r'"ellipsoid"', '"cylinder"'),
        r"wheel FL \(cylinder\): its axis is 90 deg off that of joint",
    ),
    "wheels out of round": ((r'size="0\.0254 ', 'size="0.026 '), r"wheel FL .* is out of round by 2\.4 %"),
    "wheels of another robot": (
        (r"0\.0254 0\.012 0\.0254", "0.05 0.012 0.05"),
        r"wheel FL .* has a radius of 0\.05 m; \[robot\] wheel_radius_m is 0\.0254",
    ),
    "a mass in g": ((r' mass="2\.99"', ' mass="2990"'), r"weighs 2\.99e\+03 kg; \[robot\] mass_kg is 3\.25"),
    "a robot that stands askew": (
        (r'<body name="robot"', '<body name="robot" euler="0 0 90"'),
        "body robot is turned in the file",
    ),
    "a ground of its own": (
        (r"<worldbody>", '<worldbody><geom name="floor" type="plane" size="1 1 1"/>'),
        r"geom floor \(plane\) is not of the robot: the bench brings the surface",
    ),
    "a wheel of no round shape": ((r'type="ellipsoid"', 'type="box"'), "geoms that can collide"),
    "a wheel that turns backwards": (
        (r'"drive_BR" axis="0 1 0"', '"drive_BR" axis="0 -1 0"'),
        r"joint drive_BR turns about \(0, -1, 0\)",
    ),
    "no XML": ((r"<worldbody>", "<worldbody"), r"mine\.xml, line 2: no well-formed XML .*correct the file"),
    "no MJCF": ((r"<freejoint/>", "<freejoint/><tyre/>"), r"mine\.xml, line 4, tyre: .*unrecognized element"),
    "no mass": ((r' mass="2\.99"', ' mass="0"'), r"mine\.xml, line 3, robot: mass and inertia of moving"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_with_a_file_is_named(written, case):
    change, message = WRONG[case]
    path = written(*(change if isinstance(change[0], tuple) else (change,)))
    with pytest.raises(ConfigError, match=message) as caught:
        robot(mjcf=path)
    assert f"emulation.mjcf = {path}" in str(caught.value)
    assert caught.value.exit_code == 2


def test_a_file_that_is_not_there_is_named(tmp_path):
    for path in (tmp_path / "nowhere.xml", tmp_path):
        with pytest.raises(ConfigError, match=rf"{path}: no such file; expected an MJCF file"):
            robot(mjcf=path)


def test_a_file_is_held_against_what_the_bench_says_and_not_against_the_hidden_truth(written):
    with pytest.raises(ConfigError, match=r"has it at 0\.1125, 0\.1125; that"):
        robot(7, random=True, mjcf=written((r"_FL", "_XX"), (r"_BR", "_FL"), (r"_XX", "_BR")))


def test_a_robot_that_cannot_stand_is_refused(written):
    lame = written(
        TIMESTEP,
        (
            r'<body name="fork_BL" pos="-0.1125 0.1125 0.0254"',
            '<body name="fork_BL" pos="-0.1125 0.1125 0.2"',
        ),
    )
    with pytest.raises(ConfigError, match=r"does not come to rest .*: wheels are off .*: BL by 1\.7e"):
        robot(mjcf=lame)


@pytest.mark.parametrize("shape", ["cylinder", "capsule"])
def test_wheels_that_touch_along_a_line_roll_as_those_that_touch_in_a_point(written, shape):
    """Whatever the shape, a wheel has one contact; radius, mass and what stands in the file stay."""
    size = (r'"ellipsoid" size="(\S+) (\S+) \S+"', rf'"{shape}" size="\1 \2" euler="90 0 0"')
    ends, masses = [], []
    for path in (written(TIMESTEP), written(TIMESTEP, size)):
        plant = robot(mjcf=path)
        settle(plant)
        drive(plant, 3.0, 0.2)
        wait(plant, 0.5)
        ends.append(plant.truth().pose_body_in_wall)
        masses.append(plant.parameters.mass_kg)
    np.testing.assert_allclose(ends[0], ends[1], atol=2e-5)
    assert masses[0] == pytest.approx(masses[1], rel=1e-9)


def test_springs_limits_and_zeros_of_the_joints_are_not_the_file_s_but_the_servos(written):
    """What holds a real joint is the servo that the bench brings."""
    paths = []
    for more in ("", ' stiffness="50" springref="40" damping="9" range="-2 2" limited="true"'):
        plant = robot(mjcf=written(TIMESTEP, (r'"steer_BL"', f'"steer_BL"{more}')))
        settle(plant, 0.5)
        paths.append(plant.truth().steering_true_rad)
    np.testing.assert_allclose(paths[0], paths[1], atol=1e-9)


def test_the_robot_in_the_guide_drives(tmp_path):
    guide = (Path(__file__).parents[2] / "docs" / "wall.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"```xml\n(.*?)```", guide, re.DOTALL)
    path = tmp_path / "mine.xml"
    path.write_text(text, encoding="utf-8")
    plant = robot(mjcf=path)
    assert plant.parameters.mass_kg == pytest.approx(RobotConfig().mass_kg, rel=0.01)
    settle(plant)
    drive(plant, 2.0)
    wait(plant, 1.0)
    assert plant.truth().pose_body_in_wall[0] == pytest.approx(0.97 * 2.0 * 0.0254, abs=0.003)


def test_wheels_that_weigh_more_than_the_robot_turns_are_refused():
    with pytest.raises(ConfigError, match=r"robot\.yaw_inertia_kg_m2 = 0\.001 is too small"):
        robot(config=RobotConfig(yaw_inertia_kg_m2=0.001))


def test_without_the_engine_the_line_that_installs_it_is_reported(monkeypatch):
    monkeypatch.setattr(mjcf, "why_unusable", lambda extra: "not installed")
    with pytest.raises(ConfigError, match=r"needs the extra mujoco: not installed; install") as caught:
        robot()
    assert caught.value.exit_code == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("raise OSError('libEGL.so.1: cannot open')", r"`import mujoco` fails: OSError: libEGL\.so\.1"),
        ("", "`import mujoco` fails: AttributeError: .*; see that nothing else here is called mujoco"),
    ],
)
def test_an_engine_that_is_installed_and_broken_is_named(tmp_path, monkeypatch, text, message):
    (tmp_path / "mujoco.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "mujoco")
    with pytest.raises(ConfigError, match=message) as caught:
        mjcf.load_mujoco()
    assert caught.value.exit_code == 2
