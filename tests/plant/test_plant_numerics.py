"""The plant's numbers: compiled and interpreted alike, however time is split and observed."""

import dataclasses

import numpy as np
import pytest
from plant_driving import FLOOR, MS_NS, build, drive, release, settle, wait

from hil.core.errors import UsageError
from hil.fakes.body_interface import JointCommand
from hil.fakes.plant import Patch
from hil.fakes.plant.step_kernel import advance
from hil.faults.fault import make_fault
from hil.faults.plan import FaultPlan
from tests.selected import every


def _differences(a, b):
    for field in dataclasses.fields(a):
        x, y = getattr(a, field.name), getattr(b, field.name)
        yield field.name, float(np.max(np.abs(np.asarray(x, float) - np.asarray(y, float))))


def _adventure(plant, rng):
    """All modes, steering, a loss of adhesion if there is one, torque off."""
    for k in range(12):
        drive(plant, rng.uniform(-5, 5, 4), rng.uniform(-2, 2, 4))
        plant.command(
            k % 4, JointCommand(("pwm", "current", "velocity")[k % 3], float(rng.uniform(-0.5, 0.5)))
        )
        if k == 9:
            release(plant)
        wait(plant, 0.05)
        yield plant.truth()


@pytest.mark.parametrize("case", every(2, [{"surface": "patchy"}, {}, FLOOR, {"tilt_rad": 2.0}]))
def test_machine_code_and_plain_python_agree(case, monkeypatch):
    runs = []
    for compiled in (True, False):
        faults = FaultPlan([make_fault("plant", "adhesion_loss", at=0.35, duration=0.1, factor=0.5)])
        if not compiled:
            monkeypatch.setattr("hil.fakes.plant.robot.advance", advance.py_func)
        plant = build(3, random=True, faults=faults, **case)
        runs.append(list(_adventure(plant, np.random.default_rng(5))))
    for fast, plain in zip(*runs, strict=True):
        for name, apart in _differences(fast, plain):
            assert apart <= 1e-12 * (1 if name != "normal_load_n" else 100), name


def test_the_split_of_time_changes_nothing():
    whole, parts = build(1, random=True), build(1, random=True)
    for plant in (whole, parts):
        settle(plant)
        drive(plant, 3.0, 0.3)
    wait(whole, 0.5)
    rng = np.random.default_rng(0)
    while parts.t_ns < whole.t_ns:
        parts.advance(min(whole.t_ns, parts.t_ns + int(rng.integers(1, 9)) * MS_NS + 7))
    for name, apart in _differences(whole.truth(), parts.truth()):
        assert apart == 0.0 or name == "acceleration_body", name


def test_a_look_is_a_copy_and_is_made_once_per_step():
    plant = build()
    settle(plant)
    first = plant.truth()
    assert plant.truth() is first
    pose = first.pose_body_in_wall.copy()
    drive(plant, 3.0)
    wait(plant, 0.1)
    np.testing.assert_array_equal(first.pose_body_in_wall, pose)
    assert plant.truth().pose_body_in_wall[0] > pose[0] + 1e-3
    with pytest.raises(ValueError, match="read-only"):
        first.pose_body_in_wall[0] = 1.0


def test_one_seed_is_one_robot_near_or_far_from_its_nominal_geometry():
    nominal, near, far = build(4), build(4, random=True, geometry_share=0.2), build(4, random=True)
    for name in ("wheel_x_m", "wheel_radius_m", "steering_offset_rad"):
        zero, some, full = (getattr(p.parameters, name) for p in (nominal, near, far))
        np.testing.assert_allclose(some - zero, 0.2 * (full - zero), atol=1e-15)
        assert np.all(full != zero)
    assert near.parameters.mass_kg == far.parameters.mass_kg


@pytest.mark.parametrize(
    "command", [JointCommand("velocity", float("nan")), JointCommand("position", 0.0, current_limit_a=-1.0)]
)
def test_what_is_no_command_is_refused(command):
    with pytest.raises(UsageError, match="finite goal"):
        build().command(0, command)
    with pytest.raises(UsageError, match="joint 8"):
        build().command(8, JointCommand())


def test_what_is_no_place_is_refused():
    with pytest.raises(UsageError, match="start pose"):
        build(start_pose=(0.0, 0.0, float("nan")))
    with pytest.raises(UsageError, match="one of floor, concrete, melamine"):
        build(surface="ice")
    with pytest.raises(UsageError, match="covers nothing"):
        Patch(1.0, 0.0, 0.0, 1.0, 0.5)
