"""Some seconds without samples: the heading may be lost in them, the robot may not."""

from dataclasses import replace

import numpy as np
import pytest
from estimator_drives import drive
from test_estimator_engines import assert_same, states

from hil.config.estimator import EstimatorConfig, WheelNoise
from hil.core.signals import Measurements, RobotState, Stamp, WheelMeasurement
from hil.estimator import make_estimator
from hil.robot.kinematics import NOMINAL_RADIUS_M, WheelGeometry

KINDS = ["ekf", "ukf"]
SPEED_M_S, SILENT_FROM_S, SECONDS, PERIOD_S = 0.1, 2.0, 10.0, 0.01
START = RobotState(0, np.zeros(3), np.array([SPEED_M_S, 0.0, 0.0]), np.diag([1e-8] * 6))


def straight_on(silent_s):
    """Cycles with a servo read each, of a robot that goes straight on; none for `silent_s`."""
    rate_rad_s, ahead = np.full(4, SPEED_M_S / NOMINAL_RADIUS_M), np.zeros(4)
    for k in range(1, round(SECONDS / PERIOD_S) + 1):
        t_s, t_ns = k * PERIOD_S, round(k * PERIOD_S * 1e9)
        if not SILENT_FROM_S < t_s < SILENT_FROM_S + silent_s:
            read = WheelMeasurement(Stamp(t_ns, t_ns, k), rate_rad_s * t_s, rate_rad_s, ahead, (True,) * 4)
            yield Measurements(k, t_ns, (read,))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("silent_s", [0.6, 5.0])
def test_a_robot_that_goes_straight_on_is_there_after_a_gap(kind, silent_s):
    """Wheels alone, on their process noise: the first step after the gap had thrown the UKF off the line."""
    estimator = make_estimator(
        EstimatorConfig(kind=kind).on_wheels_alone(), WheelGeometry.nominal(), surface="floor"
    )
    estimator.reset(START)
    for cycle in straight_on(silent_s):
        state = estimator.update(cycle)
        way_m = SPEED_M_S * cycle.t_ns * 1e-9
        np.testing.assert_allclose(state.pose_body_in_wall, [way_m, 0.0, 0.0], atol=1e-3)
    assert np.sqrt(state.covariance[2, 2]) > 0.5


def test_odometry_by_rates_leaves_out_a_wheel_without_one():
    """It does not count as a wheel that stands still."""
    config = EstimatorConfig(kind="odometry", wheels=WheelNoise(source="velocity"))
    estimator = make_estimator(config, WheelGeometry.nominal(), surface="floor")
    estimator.reset(START)
    for cycle in straight_on(0.0):
        lacking = cycle.wheels[0].wheel_rate_rad_s.copy()
        lacking[cycle.cycle % 4] = np.nan
        read = replace(cycle.wheels[0], wheel_rate_rad_s=lacking)
        state = estimator.update(replace(cycle, wheels=(read,)))
    way_m = SPEED_M_S * (SECONDS - PERIOD_S)
    np.testing.assert_allclose(state.pose_body_in_wall, [way_m, 0.0, 0.0], atol=1e-6)


def with_gap(cycles, silent_s, *sensors):
    """The drive without the samples of these sensors, from half a second on."""
    begin_ns = cycles.measurements[0].t_ns + 500_000_000
    end_ns = begin_ns + round(silent_s * 1e9)
    return replace(
        cycles,
        measurements=tuple(
            replace(
                m,
                **{
                    name: tuple(s for s in getattr(m, name) if not begin_ns <= s.stamp.t_ns < end_ns)
                    for name in sensors
                },
            )
            for m in cycles.measurements
        ),
    )


@pytest.mark.parametrize("kind", KINDS)
def test_compiled_engine_equals_filterpy_across_a_gap(kind):
    """From points to slopes as the heading is lost, and back as the camera finds it."""
    cycles = with_gap(drive(seconds=2.0, seed=3), 1.0, "wheels", "gyro", "tracker")
    noise = {"angular_acceleration_rad_s2_sqrt_hz": 1.0}
    config = EstimatorConfig(kind=kind, process=noise)
    ours = states(config, cycles, "floor")
    theirs = states(config.model_copy(update={"engine": "filterpy"}), cycles, "floor")
    sigma_rad = np.sqrt([state.covariance[2, 2] for state in ours])
    assert sigma_rad.max() > 0.3
    assert sigma_rad[-1] < 0.05
    assert_same(ours, theirs, 1e-9)
