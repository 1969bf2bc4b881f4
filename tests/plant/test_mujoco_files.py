"""A robot from the user's own MJCF: what it is, and what is wrong with a file that is no such robot."""

import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from mujoco_driving import mujoco, robot, truth
from plant_driving import drive, settle, wait

from hil.config.robot import RobotConfig
from hil.core.errors import ConfigError
from hil.fakes.plant.mujoco import CONTACTS, mjcf
from hil.fakes.plant.mujoco.mjcf import describe_robot
from hil.fakes.plant.mujoco.model import build_model

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


def option(text):
    return (r'<option timestep="0.001"/>', f'<option timestep="0.001" {text}/>')


def flag(text):
    return (r'<option timestep="0.001"/>', f'<option timestep="0.001"><flag {text}/></option>')


def in_front(text):
    return (r"<worldbody>", f"{text}\n<worldbody>")


SET_BACK = {
    "gravity": flag('gravity="disable"'),
    "contacts": flag('contact="disable" constraint="disable" refsafe="disable"'),
    "friction": flag('frictionloss="disable" warmstart="disable"'),
    "motors": flag('actuation="disable" clampctrl="disable"'),
    "contact overridden": (
        r'<option timestep="0.001"/>',
        '<option timestep="0.001" o_margin="0.1" o_solref="0.2 1" o_friction="2 2 0 0 0">'
        '<flag override="enable"/></option>',
    ),
    "air": option('density="1000" viscosity="10" wind="5 0 0"'),
    "field": option('gravity="0 0 5" magnetic="1 0 0" impratio="100" integrator="RK4" cone="pyramidal"'),
    "solver": option('solver="PGS" iterations="3" tolerance="1e-2" noslip_iterations="0" jacobian="sparse"'),
    "motors by group": option('actuatorgroupdisable="0 1 2"'),
    "weightless": (r'<body name="robot"', '<body name="robot" gravcomp="1"'),
    "limits": (r'name="steer_FL"', 'name="steer_FL" range="-0.1 0.1" limited="true" margin="0.05"'),
    "springs": (r'name="drive_FL"', 'name="drive_FL" stiffness="50" springref="1" damping="3" armature="1"'),
    "friction of a joint": (r'name="drive_FL"', 'name="drive_FL" frictionloss="5" solreffriction="0.5 1"'),
    "weak motor": (
        r'name="drive_FL"',
        'name="drive_FL" actuatorfrclimited="true" actuatorfrcrange="-.01 .01"',
    ),
    "offset of a joint": (r'name="steer_FL"', 'name="steer_FL" ref="0.5"'),
    "damped body": (r"<freejoint/>", '<joint type="free" damping="20" frictionloss="3" armature="4"/>'),
    "frame of the inertia": (r"<freejoint/>", '<freejoint align="true"/>'),
    "all frames": in_front('<compiler alignfree="true"/>'),
    "defaults": in_front(
        '<default><joint damping="3" armature="2"/><pair margin="0.1" gap="0.05" friction="3 3 1 1 1"/>'
        '<general gainprm="0.1" biastype="affine" biasprm="0 -9" forcerange="-1 1"/></default>'
    ),
    "scale of the solver": in_front('<statistic meaninertia="1e9" meanmass="1e3"/>'),
}


def saved(path):
    """A compiled model, byte by byte."""
    model = build_model(truth("melamine", math.pi / 2), CONTACTS["creep"], RobotConfig(), path).model
    held = np.zeros(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, held)
    return held.tobytes()


@pytest.mark.parametrize("case", SET_BACK)
def test_what_the_bench_brings_is_not_changed_by_the_file(written, case):
    assert saved(written(TIMESTEP, SET_BACK[case])) == saved(written(TIMESTEP))


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
    "a weld": (
        (r"</worldbody>", '</worldbody><equality><weld body1="robot"/></equality>'),
        "1 equalities; expected none",
    ),
    "a rope": (
        (
            r"</worldbody>",
            '</worldbody><tendon><fixed stiffness="9"><joint joint="drive_FL" coef="1"/></fixed></tendon>',
        ),
        "1 tendons; expected none",
    ),
    "a contact of its own": (
        (
            r"</worldbody>",
            '<geom name="rail" type="plane" size="1 1 1" contype="0" conaffinity="0"/></worldbody>'
            '<contact><pair geom1="rail" geom2="tyre"/></contact>',
        ),
        "1 contact pairs; expected none",
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
