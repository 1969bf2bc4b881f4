"""What enters the filter: floods, duplicates and rows that are not finite, in any order of arrival."""

from dataclasses import replace

import numpy as np
import pytest
from estimator_drives import drive

from hil.config.estimator import EstimatorConfig
from hil.core.signals import Measurements
from hil.estimator import make_estimator
from hil.estimator.event_buffer import CAPACITY
from hil.estimator.smoother import smooth
from hil.robot.kinematics import WheelGeometry


def bits(states):
    return [s.pose_body_in_wall.tobytes() + s.twist_body.tobytes() + s.covariance.tobytes() for s in states]


def filtered(cycles):
    estimator = make_estimator(EstimatorConfig(kind="ekf"), WheelGeometry.nominal(), surface="wall")
    estimator.reset(cycles.start)
    return [estimator.update(m) for m in cycles.measurements]


def smoothed(measurements, start):
    return smooth(EstimatorConfig(kind="ekf"), WheelGeometry.nominal(), "wall", measurements, start)


def without_gravity(gyro):
    """Pairs of samples with one stamp, of which only the row that is not finite differs."""
    return tuple(
        replace(g, gravity_heading_rad=heading) for g in gyro for heading in (np.nan, g.gravity_heading_rad)
    )


def test_rows_that_are_not_finite_have_one_place_whatever_their_order_of_arrival():
    cycles = drive(seconds=0.4, seed=5)
    forth = [replace(m, gyro=without_gravity(m.gyro)) for m in cycles.measurements]
    back = [replace(m, gyro=m.gyro[::-1]) for m in forth]
    twice = [replace(m, gyro=m.gyro + m.gyro) for m in forth]
    expected = bits(smoothed(forth, cycles.start))
    assert bits(smoothed(back, cycles.start)) == expected
    assert bits(smoothed(twice, cycles.start)) == expected
    assert bits(filtered(replace(cycles, measurements=forth))) == bits(
        filtered(replace(cycles, measurements=back))
    )


def test_more_samples_than_the_history_holds_are_refused_from_the_oldest_on():
    cycles = drive(seconds=0.3, seed=5)
    calm = filtered(cycles)
    *before, last = cycles.measurements
    stamp, given = last.gyro[-1].stamp, CAPACITY + 500
    flood = tuple(
        replace(last.gyro[-1], stamp=replace(stamp, t_ns=stamp.t_ns - 1000 * k, seq=stamp.seq - k))
        for k in range(given)
    )
    states = filtered(replace(cycles, measurements=(*before, replace(last, gyro=flood))))
    others = len(last.wheels) + len(last.tracker)
    refused = states[-1].diagnostics["rejected_late"] - calm[-1].diagnostics["rejected_late"]
    assert given - (CAPACITY - 1) <= refused <= given + others - (CAPACITY - 1)
    assert np.allclose(states[-1].pose_body_in_wall, calm[-1].pose_body_in_wall, atol=0.02)
    assert np.all(np.linalg.eigvalsh(states[-1].covariance) > 0.0)


def test_a_sample_that_comes_twice_is_counted_and_changes_nothing():
    cycles = drive(seconds=0.3, seed=5)
    *before, earlier, last = cycles.measurements
    again = replace(last, wheels=earlier.wheels + last.wheels)
    once, twice = filtered(cycles)[-1], filtered(replace(cycles, measurements=(*before, earlier, again)))[-1]
    assert bits([once]) == bits([twice])
    refused = twice.diagnostics["rejected_duplicate"] - once.diagnostics["rejected_duplicate"]
    assert refused == len(earlier.wheels) > 0


ABSURD = [1.001e3, -1e13, -1.7e308]


def spoilt(measurements, value):
    """A cycle's measurements in which every sensor adds an absurd sample to its good ones."""
    poses, gyro, wheels = measurements.tracker, measurements.gyro, measurements.wheels
    bad_pose = [replace(p, pose=np.array([value, 0.0, 0.1])) for p in poses]
    bad_pose += [replace(p, pose=np.array([0.1, 0.1, 1e4 * value])) for p in poses]
    bad_gyro = [replace(g, yaw_rate_rad_s=value) for g in gyro]
    bad_gyro += [replace(g, gravity_heading_rad=1e4 * value) for g in gyro]
    bad_wheels = [replace(w, wheel_angle_rad=np.full(4, 1e4 * value)) for w in wheels]
    return replace(measurements, tracker=tuple(bad_pose), gyro=tuple(bad_gyro), wheels=tuple(bad_wheels))


def run(kind, cycles, change):
    """States of a filter whose cycles 20 to 24 are changed; none may be without numbers or covariance."""
    estimator = make_estimator(EstimatorConfig(kind=kind), WheelGeometry.nominal(), surface="wall")
    estimator.reset(cycles.start)
    for k, measurements in enumerate(cycles.measurements):
        state = estimator.update(change(measurements) if 20 <= k < 25 else measurements)
        assert np.isfinite(state.pose_body_in_wall).all()
        assert np.isfinite(state.covariance).all()
        assert np.linalg.eigvalsh(state.covariance)[0] > 0.0
    return state


@pytest.mark.filterwarnings("ignore:overflow encountered")
@pytest.mark.parametrize("kind", ["ekf", "ukf"])
@pytest.mark.parametrize("value", ABSURD)
def test_absurd_values_are_refused_as_if_they_had_not_come(kind, value):
    cycles = drive(seconds=0.6, seed=5)
    state = run(kind, cycles, lambda m: spoilt(m, value))
    calm = run(kind, cycles, lambda m: Measurements(m.cycle, m.t_ns))
    assert state.diagnostics["rejected_implausible"] > 0
    np.testing.assert_array_equal(state.pose_body_in_wall, calm.pose_body_in_wall)
    np.testing.assert_array_equal(state.covariance, calm.covariance)


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_what_is_just_not_absurd_leaves_a_covariance(kind):
    run(kind, drive(seconds=0.6, seed=5), lambda m: spoilt(m, 999.0))


@pytest.mark.parametrize("kind", ["odometry", "ekf"])
def test_whole_turns_of_the_steering_change_no_estimate(kind):
    """Modules half a turn round, driven backwards: their angles lie on both sides of the wrap at pi."""
    cycles = drive(seconds=0.4, seed=5)

    def estimated(change):
        estimator = make_estimator(EstimatorConfig(kind=kind), WheelGeometry.nominal(), surface="wall")
        estimator.reset(cycles.start)
        return [
            estimator.update(replace(m, wheels=tuple(map(change, m.wheels)))).pose_body_in_wall
            for m in cycles.measurements
        ]

    def turned(w):
        steering = np.angle(np.exp(1j * (w.steering_rad + np.pi)))
        return replace(
            w, wheel_angle_rad=-w.wheel_angle_rad, wheel_rate_rad_s=-w.wheel_rate_rad_s, steering_rad=steering
        )

    np.testing.assert_allclose(estimated(turned), estimated(lambda w: w), atol=1e-9)
