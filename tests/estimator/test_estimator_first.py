"""The estimator's promises to the loop: deterministic, in any arrival order, and never NaN."""

import itertools
import math

import numpy as np
import pytest

from hil.config.estimator import EstimatorConfig
from hil.core.errors import ConfigError, UsageError
from hil.core.signals import (
    GyroMeasurement,
    Measurements,
    PoseMeasurement,
    RobotState,
    Stamp,
    WheelMeasurement,
)
from hil.estimator import make_estimator
from hil.robot.kinematics import WheelGeometry

STEP_NS = 10_000_000
START = RobotState(0, np.zeros(3), np.zeros(3), np.eye(6) * 1e-6)


def wheels(k, t_ns, speed_m_s=0.05, radius_m=0.0254):
    angle = np.full(4, speed_m_s * t_ns * 1e-9 / radius_m)
    rate = np.full(4, speed_m_s / radius_m)
    return WheelMeasurement(Stamp(t_ns, t_ns, k), angle, rate, np.zeros(4), (True,) * 4)


def gyro(k, t_ns, rng):
    rate, heading = 0.003 * rng.normal() + 0.01, 0.01 * rng.normal()
    return GyroMeasurement(Stamp(t_ns, t_ns, k), rate, heading, np.zeros(2))


def camera(k, t_ns, rng, speed_m_s=0.049):
    pose = np.array([speed_m_s * t_ns * 1e-9, 0.0, 0.0]) + rng.normal(size=3) * (k > 0) * 1e-3
    return PoseMeasurement(Stamp(t_ns, t_ns, k), "tracker", pose, 3, True)


def stream(seconds=2.0, seed=0):
    """All samples of a short drive, each with the time at which it was measured."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(int(seconds * 100)):
        t = (k + 1) * STEP_NS
        out += [("wheels", wheels(k, t)), ("gyro", gyro(k, t, rng))]
        out += [("tracker", camera(2 * k + i, t - 3_000_000 + i * 5_000_000, rng)) for i in (0, 1)]
    return out


def feed(estimator, samples, delay_ns):
    """Deliver samples in 10 ms cycles, each after a delay of its own; the state at the end."""
    estimator.reset(START)
    arriving = sorted(
        ((s.stamp.t_ns + delay_ns(i), i, kind, s) for i, (kind, s) in enumerate(samples)),
        key=lambda a: (a[0], a[1]),
    )
    end_ns = max(a[0] for a in arriving) + STEP_NS
    queue, state = list(arriving), None
    for cycle, t_ns in enumerate(range(STEP_NS, end_ns + STEP_NS, STEP_NS)):
        ready = list(itertools.takewhile(lambda a, now=t_ns: a[0] <= now, queue))
        queue = queue[len(ready) :]
        parts = {k: tuple(s for _, _, kind, s in ready if kind == k) for k in ("wheels", "gyro", "tracker")}
        state = estimator.update(Measurements(cycle, t_ns, **parts))
    return estimator.update(Measurements(0, 4_000_000_000)), state


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_arrival_order_does_not_change_a_bit(kind):
    samples = stream()
    rng = np.random.default_rng(5)
    late = rng.integers(0, 150_000_000, size=len(samples))
    results = []
    for delay in (lambda i: 0, lambda i: int(late[i]), lambda i: int(late[-1 - i])):
        estimator = make_estimator(EstimatorConfig(kind=kind), WheelGeometry.nominal(), surface="wall")
        results.append(feed(estimator, samples, delay)[0])
    for other in results[1:]:
        assert np.array_equal(results[0].pose_body_in_wall, other.pose_body_in_wall)
        assert np.array_equal(results[0].twist_body, other.twist_body)
        assert np.array_equal(results[0].covariance, other.covariance)


@pytest.mark.parametrize("kind", ["odometry", "ekf", "ukf"])
def test_bad_input_is_counted_and_never_makes_nan(kind):
    estimator = make_estimator(EstimatorConfig(kind=kind), WheelGeometry.nominal(), surface="wall")
    estimator.reset(START)
    bad = math.nan
    for k, (t, value) in enumerate([(STEP_NS, 0.0), (2 * STEP_NS, bad), (3 * STEP_NS, math.inf)]):
        stamp = Stamp(t, t, k)
        state = estimator.update(
            Measurements(
                k,
                t,
                (
                    WheelMeasurement(stamp, np.full(4, value), np.zeros(4), np.zeros(4), (True,) * 4),
                    WheelMeasurement(stamp, np.zeros(3), np.zeros(4), np.zeros(4), (True,) * 4),
                    WheelMeasurement(stamp, np.zeros(4), np.zeros(4), np.zeros(4), (True,) * 3),
                ),
                (GyroMeasurement(stamp, value, value, np.array([value, 0.0])),),
                (
                    PoseMeasurement(stamp, "tracker", np.array([value, 0.0, 0.0]), 3, True),
                    PoseMeasurement(Stamp(t + 10**12, t, k), "tracker", np.zeros(3), 3, True),
                    PoseMeasurement(Stamp(t - 10**12, t, k), "tracker", np.zeros(3), 3, True),
                ),
            )
        )
        assert np.all(np.isfinite(state.pose_body_in_wall))
        assert np.all(np.isfinite(state.covariance))
    found = state.diagnostics
    if kind != "odometry":
        assert found["rejected_not_finite"] == 6
        assert found["rejected_shape"] == 6
        assert found["rejected_future"] == 3
        assert found["rejected_late"] == 3
    else:
        assert found["rejected_wheels"] == 8


def test_two_free_scales_and_bad_starts_are_refused_by_name():
    with pytest.raises(ValueError, match="wheel_scale_sigma"):
        EstimatorConfig(wheel_scale_sigma=0.01)
    config = EstimatorConfig().model_copy(update={"wheel_scale_sigma": 0.01})
    with pytest.raises(ConfigError, match=r"tracker\.scale_sigma"):
        make_estimator(config, WheelGeometry.nominal(), surface="wall")
    with pytest.raises(ConfigError, match="ceiling"):
        make_estimator(EstimatorConfig(), WheelGeometry.nominal(), surface="ceiling")
    estimator = make_estimator(EstimatorConfig(), WheelGeometry.nominal(), surface="wall")
    with pytest.raises(UsageError, match="eigenvalue"):
        estimator.reset(RobotState(0, np.zeros(3), np.zeros(3), -np.eye(6)))
    with pytest.raises(UsageError, match="finite"):
        estimator.reset(RobotState(0, np.full(3, math.nan), np.zeros(3), np.eye(6)))
