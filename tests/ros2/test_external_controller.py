"""What joint and velocity commands of a program mean, and by which the robot stops."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hil.bench import make_bench_model
from hil.config.loading import load_bench
from hil.core.errors import SafetyStop
from hil.core.external_commands import ExternalCommand, ExternalCommands
from hil.core.signals import (
    SERVOS,
    CycleRecord,
    Inputs,
    Measurements,
    RobotState,
    ServoSetpoint,
    Stamp,
    WheelMeasurement,
    WheelSetpoint,
)
from hil.loop.alignment import Alignment

PERIOD_NS = 10_000_000
STEER = (0.1, -0.2, 0.3, -0.4)
DRIVE = (1.0, -2.0, 3.0, -4.0)
MEASURED = np.array([0.01, 0.02, -0.03, 0.04])
TURNED = {"alignment.drive_sign": [1, 1, -1, -1], "alignment.steer_zero_rad": [0.1, 0.2, -0.1, 0.0]}


def controller(overrides=None):
    model = make_bench_model(load_bench("emulated_floor", overrides=overrides or {}))
    return model.make_pipeline(None, controller="ros2:/joint_commands").external, model


def joints(t_ns, names=SERVOS, position=STEER, velocity=DRIVE, effort=(), stamp_ns=None):
    columns = (np.array(c, dtype=np.float64) for c in (position, velocity, effort))
    return ExternalCommand(t_ns, stamp_ns, "joints", tuple(names), *columns)


def twist(t_ns, *values):
    return ExternalCommand(t_ns, None, "twist", (), np.zeros(0), np.array(values, dtype=float), np.zeros(0))


def asked(external, cycle, *commands):
    """Setpoint of a cycle in which these commands come."""
    t_ns = cycle * PERIOD_NS
    external.ask = lambda _: ExternalCommands(commands)
    state = RobotState(t_ns, np.zeros(3), np.zeros(3), np.eye(6))
    rest, goals = WheelSetpoint(np.zeros(4), np.zeros(4)), ServoSetpoint(np.zeros(4), np.zeros(4))
    inputs = Inputs(cycle, t_ns)
    seen = CycleRecord(cycle, t_ns, t_ns, inputs, Measurements(cycle, t_ns), state, None, rest, goals)
    stamp = Stamp(t_ns, t_ns, cycle)
    wheels = WheelMeasurement(stamp, np.zeros(4), np.zeros(4), MEASURED, (True,) * 4)
    return external.update(seen, wheels)


def after(external, cycles, command):
    """Setpoint when a command has come again and again."""
    return [asked(external, k, replace(command, t_ns=k * PERIOD_NS)) for k in range(1, cycles + 1)][-1]


@pytest.mark.parametrize("overrides", [{}, TURNED])
@pytest.mark.parametrize("order", [range(8), (7, 0, 6, 1, 5, 2, 4, 3)])
def test_a_command_reaches_the_joints_that_it_names_as_joint_states_has_them(overrides, order):
    external, model = controller(overrides)
    values = dict(zip(SERVOS, (*DRIVE, *STEER), strict=True))
    names = [SERVOS[k] for k in order]
    position = [values[n] for n in names if n.startswith("steer")]
    velocity = [values[n] for n in names if n.startswith("drive")]
    setpoint = after(external, 60, joints(0, names, position, velocity))
    goals = Alignment(model.alignment_parameters).to_servos(setpoint)
    np.testing.assert_allclose(goals.steer_position_rad, STEER, atol=1e-12)
    np.testing.assert_allclose(goals.drive_velocity_rad_s, DRIVE, atol=1e-12)


def test_nothing_moves_before_the_first_command_and_steering_goes_no_faster_than_the_servos():
    external, model = controller()
    for cycle in range(5):
        setpoint = asked(external, cycle)
        assert not setpoint.wheel_rate_rad_s.any()
        np.testing.assert_array_equal(setpoint.steering_rad, MEASURED)
        assert not external.begun
    angles = [asked(external, k, joints(k * PERIOD_NS)).steering_rad for k in range(5, 25)]
    steps = np.abs(np.diff([MEASURED, *angles], axis=0))
    assert external.begun
    assert steps.max() <= model.config.control.steering_rate_rad_s * PERIOD_NS * 1e-9 + 1e-12
    np.testing.assert_allclose(angles[-1], STEER, atol=1e-12)


def test_a_velocity_rolls_the_wheels_as_a_rigid_body_within_the_limits():
    external, model = controller()
    wanted = np.array([0.05, 0.0, 0.02])
    setpoint = after(external, 100, twist(0, 0.05, 0, 0, 0, 0, 0.02))
    angle = setpoint.steering_rad + model.geometry.steering_zero_rad
    speed = setpoint.wheel_rate_rad_s * model.geometry.radius_m
    # the wheels were measured at rest all the while, so that cosines of the angles still to turn slow them
    answer = np.column_stack([np.cos(angle), np.sin(angle)]).ravel() * np.repeat(np.sign(speed), 2)
    there = (model.geometry.projection() @ wanted).reshape(4, 2)
    there /= np.hypot(*there.T)[:, None]
    np.testing.assert_allclose(answer.reshape(4, 2), there, atol=1e-9)
    fast = after(external, 5, twist(0, 9.0, 0, 0, 0, 0, 0))
    assert np.abs(fast.wheel_rate_rad_s * model.geometry.radius_m).max() <= 0.122 + 1e-9


OTHER = ("drive_XX", *SERVOS[1:])
WRONG = {
    "unknown": (joints(0, OTHER), "drive_XX"),
    "double": (joints(0, (*SERVOS[:7], "steer_FL")), "double"),
    "missing": (joints(0, SERVOS[:7], STEER[:3]), "steer_FR"),
    "all positions": (joints(0, position=(*STEER, *STEER)), "8 values of position"),
    "no velocity": (joints(0, velocity=()), "0 values of velocity"),
    "effort": (joints(0, effort=(1.0,)), "effort"),
    "nan": (joints(0, position=(0.0, math.nan, 0.0, 0.0)), "steer_BL"),
    "degrees": (joints(0, position=(0.0, 0.0, 0.0, 45.0)), "degrees"),
    "rpm": (joints(0, velocity=(0.0, 30.0, 0.0, 0.0)), "rpm"),
    "twist nan": (twist(0, math.nan, 0, 0, 0, 0, 0), "not finite"),
    "twist up": (twist(0, 0, 0, 0.1, 0, 0, 0), "off the surface"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_what_a_command_cannot_mean_stops_the_robot_by_name(wrong):
    command, answer = WRONG[wrong]
    external, _ = controller()
    with pytest.raises(SafetyStop, match=answer) as stop:
        asked(external, 1, command)
    assert stop.value.reason == "ros2_command"
    assert "/joint_commands" in str(stop.value)


def test_a_mirrored_joint_has_its_limit_where_it_is():
    external, _ = controller(
        {
            "alignment.steer_zero_rad": [2.0, 0.0, 0.0, 0.0],
            "servos.steer_mode": "extended",
            "servos.steer_limit_rad": 4.2,
        }
    )
    asked(external, 1, joints(0, position=(4.0, 0.0, 0.0, 0.0)))
    with pytest.raises(SafetyStop, match="steer_FL"):
        asked(external, 2, joints(0, position=(-0.5, 0.0, 0.0, 0.0)))


def test_silence_stops_the_robot_after_the_stated_time_and_not_before():
    external, _ = controller({"ros2.late_after_s": 0.05})
    asked(external, 1, joints(PERIOD_NS))
    last = 1 + 5
    for cycle in range(2, last + 1):
        assert asked(external, cycle).wheel_rate_rad_s.any()
    with pytest.raises(SafetyStop) as stop:
        asked(external, last + 1)
    assert stop.value.reason == "ros2_late"


@pytest.mark.parametrize("step_ns", [0, -PERIOD_NS])
def test_stamps_that_do_not_go_on_stop_the_robot(step_ns):
    external, _ = controller()
    for k in range(1, 22):
        asked(external, k, joints(k * PERIOD_NS, stamp_ns=5 * 10**9 + k * step_ns))
    with pytest.raises(SafetyStop) as stop:
        asked(external, 22, joints(22 * PERIOD_NS, stamp_ns=5 * 10**9 + 22 * step_ns))
    assert stop.value.reason == "ros2_time"
    external.reset()
    for k in range(1, 100):
        asked(external, k, joints(k * PERIOD_NS))  # without stamps nothing stands
