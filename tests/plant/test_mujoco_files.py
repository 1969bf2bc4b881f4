"""A robot from the user's own MJCF: what it is, and what is wrong with a file that is no such robot."""

import math
import re

import numpy as np
import pytest
from mujoco_driving import robot, truth
from plant_driving import drive, settle, wait

from hil.config.robot import RobotConfig
from hil.fakes.mujoco_plant import model as model_module
from hil.fakes.mujoco_plant.description import describe_robot
from hil.vocabulary.errors import ConfigError

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
        (r"steer_BL", "stear_BL"), "joint steer_BL is missing; did you mean stear_BL?",
    ),
    "a joint that slides": ((r'"steer_FR" ', '"steer_FR" type="slide" '), "joint steer_FR is not a hinge"),
    "a fifth wheel": (
        (
            r"</body>\n  </worldbody>",
            '<body><joint name="drive_ML" axis="0 1 0"/><geom size="0.02"/></body></body></worldbody>',
        ),
        "joints beside the eight of four wheels: drive_ML",
    ),
    "no free joint": ((r"<freejoint/>", ""), "0 free joints; expected one"),
    "a wheel of no round shape": ((r'type="ellipsoid"', 'type="box"'), "geoms that can collide"),
    "motors of its own": (
        (r"</worldbody>", '</worldbody><actuator><motor joint="drive_FL"/></actuator>'),
        "1 actuators; expected none",
    ),
    "a step that servos do not bear": (
        (r"<worldbody>", '<option timestep="0.01"/><worldbody>'), "option timestep = 0.01 s is unstable",
    ),
    "a wheel that turns backwards": (
        (r'"drive_BR" axis="0 1 0"', '"drive_BR" axis="0 -1 0"'), r"joint drive_BR turns about \(0, -1, 0\)",
    ),
    "no XML": ((r"<worldbody>", "<worldbody"), "XML"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_with_a_file_is_named(written, case):
    change, message = WRONG[case]
    path = written(change)
    with pytest.raises(ConfigError, match=message) as caught:
        robot(mjcf=path)
    assert f"emulation.mjcf = {path}" in str(caught.value)
    assert caught.value.exit_code == 2


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"nowhere\.xml"):
        robot(mjcf=tmp_path / "nowhere.xml")


def test_a_robot_that_cannot_stand_is_refused(written):
    lame = written(
        TIMESTEP,
        (
            r'<body name="fork_BL" pos="-0.1125 0.1125 0.0254"',
            '<body name="fork_BL" pos="-0.1125 0.1125 0.2"',
        ),
    )
    with pytest.raises(ConfigError, match="does not come to rest on its wheels"):
        robot(mjcf=lame)


def test_wheels_that_weigh_more_than_the_robot_turns_are_refused():
    with pytest.raises(ConfigError, match=r"robot\.yaw_inertia_kg_m2 = 0\.001 is too small"):
        robot(config=RobotConfig(yaw_inertia_kg_m2=0.001))


def test_without_the_engine_the_line_that_installs_it_is_told(monkeypatch):
    monkeypatch.setattr(model_module, "lacks", lambda extra: "not installed")
    with pytest.raises(ConfigError, match=r"needs the extra mujoco: not installed; install") as caught:
        robot()
    assert caught.value.exit_code == 2
