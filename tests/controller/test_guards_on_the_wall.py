"""Guards on the emulated wall: whatever goes wrong, the robot ends held, with torque on."""

import contextlib
import math

import numpy as np
import pytest

from hil.bench import open_bench
from hil.core.errors import DeviceTimeoutError, SafetyStop, TrajectoryError
from hil.robot.paths import Segment, Straight
from hil.robot.trajectories import Trajectory, circle, line
from tests.selected import every

ORIGIN = np.zeros(3)
SECOND_NS = 1_000_000_000


@contextlib.contextmanager
def open_wall(faults=(), **overrides):
    dotted = {key.replace("__", "."): value for key, value in overrides.items()}
    with open_bench("emulated", seed=0, faults=faults, overrides=dotted) as bench:
        yield bench
        bench.devices.actuators().close()  # `assert_held` has looked


def drive(bench, length_m=0.25, duration_s=6.0, start=ORIGIN, **options):
    """Up the wall from a known start; returns the cycle records."""
    records = []
    way = line(start, np.add(start, [length_m, 0, 0]), duration_s=duration_s)
    options = {"hold_s": 0.5, "start_pose": start, **options}
    bench.drive(way, **{"on_cycle": records.append, **options})
    return records


def assert_held(bench):
    """Wheels at rest and torque on: without torque the robot would roll down by centimetres in a second."""
    bench.clock.sleep_until_ns(bench.clock.now_ns() + SECOND_NS // 2)
    before = bench.truth()
    bench.clock.sleep_until_ns(bench.clock.now_ns() + SECOND_NS)
    after = bench.truth()
    assert np.abs(after.joint_velocity_rad_s).max() < 1e-3
    if not after.fallen:
        np.testing.assert_allclose(after.pose_body_in_wall, before.pose_body_in_wall, atol=5e-5)
        assert np.abs(after.joint_current_a[:4]).sum() > 0.01


@pytest.mark.parametrize(
    ("fault", "reason"),
    every(2, [("plant:adhesion_loss@1.5", "adhesion"), ("plant:adhesion_loss@1.5,factor=0.42", "adhesion")]),
)
def test_a_fault_under_way_stops_and_holds(fault, reason):
    with open_wall((fault,)) as bench:
        with pytest.raises(SafetyStop) as stop:
            drive(bench)
        assert stop.value.reason == reason
        assert_held(bench)


def test_a_robot_that_slides_under_rolling_wheels_is_stopped_where_no_sensor_measures_its_adhesion():
    with open_wall(("plant:adhesion_loss@1,factor=0.42",), adhesion=None, load_cells=None) as bench:
        with pytest.raises(SafetyStop) as stop:
            drive(bench)
        assert stop.value.reason == "sensors_disagree"
        assert_held(bench)


@pytest.mark.parametrize("device", every(2, ["imu", "tracker"]))
def test_a_sensor_that_stays_silent_stops_the_robot(device):
    with open_wall((f"{device}:off@0.8",)) as bench:
        with pytest.raises(DeviceTimeoutError, match=device):
            drive(bench)
        assert_held(bench)


def test_heading_beyond_its_limit_stops_the_robot():
    """A robot that does not correct its heading turns as it climbs; the limit is set close to see it soon."""
    limits = {
        "control__law": "nonlinear",
        "control__gains": [4.0, 4.0, 0.01],
        "safety__heading_limit_rad": 0.008,
    }
    with open_wall(**limits) as bench:
        with pytest.raises(SafetyStop, match=r"heading -0\.5 deg exceeds 0\.5 deg") as stop:
            drive(bench, 0.6, 12.0)
        assert stop.value.reason == "heading"
        assert_held(bench)


def test_commands_stay_within_limits_whatever_the_gains():
    wild = {
        "control__law": "nonlinear",
        "control__gains": [80.0, 80.0, 80.0],
        "safety__wheel_rate_limit_rad_s": 2.0,
    }
    records = []
    with open_wall(**wild) as bench:
        start = np.array([0.01, 0.01, 0.0])
        with contextlib.suppress(SafetyStop):
            drive(bench, 0.1, 2.0, start=start, on_cycle=records.append)
        rates = np.array([r.command.drive_velocity_rad_s for r in records])
        steering = np.array([r.command.steer_position_rad for r in records])
        assert len(records) > 50
        assert np.abs(rates).max() == pytest.approx(2.0)
        assert np.abs(steering).max() <= bench.config.safety.steering_limit_rad
        assert_held(bench)


REFUSED = [
    (circle(ORIGIN, 0.3), "heading on the wall"),
    (line(ORIGIN, [0.0, -2.5, 0.0]), "-y on the wall"),
    (line(ORIGIN, [1.0, 0.0, 0.0], duration_s=14.0), "wheel speed"),
    (line(ORIGIN, [0.05, 0.0, 0.0], duration_s=0.9), "wheel acceleration"),
    (Trajectory("none", (Segment(Straight((0.0, 0.0, 0.0), (math.nan, 0.0, 0.0)), 5.0),)), "reference"),
]


def test_what_cannot_be_followed_is_refused_before_anything_moves():
    with open_wall() as bench:
        bench.clock.sleep_until_ns(SECOND_NS // 10)
        before = bench.truth()
        for trajectory, quantity in REFUSED:
            with pytest.raises(TrajectoryError, match=quantity) as refusal:
                bench.drive(trajectory)
            assert 0.0 <= refusal.value.t_s <= trajectory.duration_s + 0.01
            assert not refusal.value.value <= refusal.value.limit
        after = bench.truth()
        assert after.t_ns == before.t_ns
        np.testing.assert_array_equal(after.joint_position_rad, before.joint_position_rad)


def test_references_may_be_held_closer_than_the_robot():
    turn = line(ORIGIN, [0.0, 0.0, math.radians(10.0)])
    closer = open_wall(control__heading_limit_rad=math.radians(8.0))
    with closer as bench, pytest.raises(TrajectoryError, match="heading on the wall"):
        bench.check(turn)
    with open_wall() as bench:
        bench.check(turn)
