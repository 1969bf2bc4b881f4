"""Kernels against their laws: derivatives, exact linear cases, positive covariances.

Where a law is one of a single call, the kernel's source is run as it is: compiling it takes half a minute.
"""

from dataclasses import replace

import numpy as np
import pytest

from hil.config.estimator import EstimatorConfig
from hil.core.named_records import dtype_of, filled
from hil.core.signals import GyroMeasurement, Measurements, PoseMeasurement, RobotState, Stamp
from hil.estimator import constant_twist, event_loop, kalman_update, make_estimator, sensors
from hil.estimator import matrix_loops as small
from hil.estimator import process_model as model
from hil.estimator.kernel_layout import ROW, first_memory, parameters
from hil.estimator.sensors import NUMBERS, tracker, wheels
from hil.estimator.sigma_points import points_of
from hil.estimator.state_vector import CLONE, OMEGA, POSE, ROWS, STATES, prior_variances
from hil.estimator.state_vector import SCALE as STATE_SCALE
from hil.robot.kinematics import WheelGeometry
from hil.support.numba_jit import kernel

SCALE = np.array([1, 1, 1, 0.1, 0.1, 0.3, 1, 1, 1, 5e-3, 0.01, 0.01, 2e-3, 2e-3, 0.05, 0.05, 5e-3, 1, 1, 1])
ROLLING = np.array([0.07, -0.04])


def some_state(rng):
    x = SCALE * rng.normal(size=STATES)
    x[CLONE] = x[:3] + 0.05 * rng.normal(size=3)
    return x


def some_covariance(rng):
    a = SCALE[:, None] * rng.normal(size=(STATES, STATES))
    return a @ a.T


def slope(f, x, step=1e-6):
    columns = []
    for i in range(len(x)):
        d = np.zeros_like(x)
        d[i] = step
        columns.append((f(x + d) - f(x - d)) / (2 * step))
    return np.array(columns).T


def kernel_parameters(surface="wall", **changes):
    return parameters(EstimatorConfig(**changes), WheelGeometry.nominal(), surface)[0]


@pytest.mark.parametrize("omega", [0.0, 1e-7, 0.4, -2.0])
def test_transition_is_the_derivative_of_move(omega):
    rng = np.random.default_rng(1)
    x = some_state(rng)
    x[OMEGA] = omega

    def moved(y):
        out = y.copy()
        constant_twist.move(out, 0.07, 5.0, 1.0, x[STATE_SCALE], ROLLING)
        return out

    assert np.allclose(constant_twist.transition(x, 0.07, 5.0, 1.0, ROLLING), slope(moved, x), atol=1e-8)


def test_written_out_prediction_equals_the_matrix_product():
    rng = np.random.default_rng(2)
    par = kernel_parameters().process
    x, p = some_state(rng), some_covariance(rng)
    f = constant_twist.transition(x, 0.02, par.slip_s, par.scaled, ROLLING)
    want = f @ p @ f.T
    model.add_noise(x, want, 0.02, par)
    model.advance_linear(x, p, 0.02, par, ROLLING)
    assert np.allclose(p, want, rtol=1e-12, atol=1e-13)
    assert np.array_equal(p, p.T)


@pytest.mark.parametrize("sensor", NUMBERS)
@pytest.mark.parametrize(
    "changes",
    [{}, {"wheels": {"model": "dry-friction"}}, {"wheel_scale_sigma": 0.01, "tracker": {"scale_sigma": 0.0}}],
)
def test_measurement_jacobians(sensor, changes):
    rng = np.random.default_rng(3)
    par, number = kernel_parameters(**changes), NUMBERS[sensor]
    aux = np.array([0.016, 0.0011, 8e-4, -6e-4, 2e-3])
    for _ in range(5):
        x = some_state(rng)

        def seen(y):
            out = np.zeros(ROWS)
            sensors.predicted(number, y, aux, par, out)
            return out

        h = np.zeros((ROWS, STATES))
        sensors.jacobian(number, x, aux, par, h)
        assert np.allclose(h, slope(seen, x), atol=2e-8)


def seen_pose(pose):
    """Event row of a camera that shows a pose."""
    where = dict(zip(("x_m", "y_m", "heading_rad"), pose, strict=True))
    return filled(dtype_of(tracker.Row), {**where, "quality": 3.0, "valid": 1.0})[0]


def test_a_new_camera_frame_shows_what_the_camera_shows_and_spreads_its_uncertainty():
    """Right after anchoring the predicted pose is the measured one, with the measurement's variance."""
    rng = np.random.default_rng(4)
    par = kernel_parameters(tracker={"position_m": 2e-3, "heading_rad": 3e-3, "scale_sigma": 0.01}).tracker
    x, p = some_state(rng), some_covariance(rng)
    z = np.array([0.4, -0.2, 0.3])
    tracker.new_frame(0.0, x, p, first_memory()[0].tracker, seen_pose(z), par)
    mean, h = np.zeros(ROWS), np.zeros((ROWS, STATES))
    tracker.predicted(x, np.zeros(2), par, mean)
    tracker.jacobian(x, np.zeros(2), par, h)
    assert np.allclose(mean[:3], z, atol=1e-12)
    assert np.allclose((h @ p @ h.T)[:3, :3], np.diag([4e-6, 4e-6, 9e-6]), atol=1e-12)


def test_cloning_correlates_fully():
    rng = np.random.default_rng(5)
    x, p = some_state(rng), some_covariance(rng)
    wheels.clone_pose(x, p)
    assert np.array_equal(x[POSE], x[CLONE])
    difference = np.zeros((3, STATES))
    difference[:, :3], difference[:, CLONE] = np.eye(3), -np.eye(3)
    assert np.allclose(difference @ p @ difference.T, 0.0, atol=1e-12)


def test_row_by_row_conditioning_is_the_stacked_kalman_update():
    rng = np.random.default_rng(6)
    for count in (1, 3, 8):
        x, p = some_state(rng), some_covariance(rng)
        h = rng.normal(size=(count, STATES))
        r, z = rng.uniform(0.1, 2.0, count), rng.normal(size=count)
        s = h @ p @ h.T + np.diag(r)
        gain = p @ h.T @ np.linalg.inv(s)
        want_x, want_p = x + gain @ (z - h @ x), p - gain @ s @ gain.T
        nu, cross, own, var = np.zeros(8), np.zeros((8, STATES)), np.zeros((8, 8)), np.zeros(8)
        nu[:count], var[:count], cross[:count] = z - h @ x, r, h @ p
        own[:count, :count] = h @ p @ h.T
        rows = kalman_update.Compared(nu, cross, own, var, np.zeros(8))
        assert kalman_update.condition(x, p, rows, count, np.inf) == count
        assert np.allclose(x, want_x, atol=1e-9)
        assert np.allclose(p, want_p, atol=1e-9)


STILL = {"acceleration_m_s2_sqrt_hz": 1e-9, "angular_acceleration_rad_s2_sqrt_hz": 1e-9}
PLAIN = {"mocap": {"use": True, "position_m": 1.0, "heading_rad": 1.0}, "gates": {"on": False}}


def mocap(t_ns, seq, x_m):
    return PoseMeasurement(Stamp(t_ns, t_ns, seq), "mocap", np.array([x_m, 0.0, 0.0]), 3, True)


@pytest.mark.parametrize("engine", ["compiled", "filterpy"])
@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_exact_scalar_cases(kind, engine):
    """P = R = 1 gives 1/2; P0 = 1e-6, Q dt = 1, R = 1, z = 1 gives x = P = 1/2."""
    config = EstimatorConfig(kind=kind, engine=engine, process=STILL, **PLAIN)
    estimator = make_estimator(config, WheelGeometry.nominal(), surface="floor")
    estimator.reset(RobotState(0, np.zeros(3), np.zeros(3), np.diag([1.0, 1e-18, 1e-18, 0, 0, 0])))
    state = estimator.update(Measurements(0, 1000, mocap=(mocap(1000, 0, 1.0),)))
    assert state.pose_body_in_wall[0] == pytest.approx(0.5, abs=1e-9)
    assert state.covariance[0, 0] == pytest.approx(0.5, abs=1e-9)

    walk = {**STILL, "acceleration_m_s2_sqrt_hz": np.sqrt(3.0 * (1.0 - 1e-6))}
    config = EstimatorConfig(kind=kind, engine=engine, process=walk, **PLAIN)
    estimator = make_estimator(config, WheelGeometry.nominal(), surface="floor")
    estimator.reset(RobotState(0, np.zeros(3), np.zeros(3), np.diag([1e-6, 1e-6, 0, 0, 0, 0])))
    state = estimator.update(Measurements(0, 10**9, mocap=(mocap(10**9, 0, 1.0),)))
    assert state.pose_body_in_wall[0] == pytest.approx(0.5, abs=1e-9)
    assert state.covariance[0, 0] == pytest.approx(0.5, abs=1e-9)


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_several_updates_within_microseconds(kind):
    """n updates with P = R = 1 and z = 1 give x = n / (n + 1), P = 1 / (n + 1) (filterpy: 1 and 0)."""
    config = EstimatorConfig(kind=kind, process=STILL, **PLAIN)
    estimator = make_estimator(config, WheelGeometry.nominal(), surface="floor")
    estimator.reset(RobotState(0, np.zeros(3), np.zeros(3), np.diag([1.0, 1e-18, 1e-18, 0, 0, 0])))
    for n in (1, 2, 3, 4):
        state = estimator.update(Measurements(n, 1000 * n, mocap=(mocap(1000 * n, n, 1.0),)))
        assert state.pose_body_in_wall[0] == pytest.approx(n / (n + 1), abs=1e-9)
        assert state.covariance[0, 0] == pytest.approx(1 / (n + 1), abs=1e-9)


@pytest.mark.parametrize("engine", ["compiled", "filterpy"])
@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_on_a_linear_model_every_filter_is_the_kalman_filter(kind, engine):
    """Straight motion with known heading is linear in position and speed."""
    q, r, dt = 0.3, 0.05, 0.1
    process = {**STILL, "acceleration_m_s2_sqrt_hz": q}
    config = EstimatorConfig(
        kind=kind,
        engine=engine,
        process=process,
        gates={"on": False},
        mocap={"use": True, "position_m": r, "heading_rad": 10.0},
    )
    estimator = make_estimator(config, WheelGeometry.nominal(), surface="floor")
    start = np.diag([0.2**2, 1e-20, 0, 0.1**2, 0, 0])
    estimator.reset(RobotState(0, np.zeros(3), np.zeros(3), start))
    x, p = np.zeros(2), np.diag([0.2**2, 0.1**2])
    f, noise = np.array([[1, dt], [0, 1]]), q * q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    rng = np.random.default_rng(7)
    for k in range(1, 100):
        z = 0.1 * k * dt + r * rng.normal()
        x, p = f @ x, f @ p @ f.T + noise
        gain = p[:, 0] / (p[0, 0] + r * r)
        x, p = x + gain * (z - x[0]), p - np.outer(gain, p[0])
        t_ns = round(k * dt * 1e9)
        state = estimator.update(Measurements(k, t_ns, mocap=(mocap(t_ns, k, z),)))
        assert state.pose_body_in_wall[0] == pytest.approx(x[0], abs=1e-9)
        assert state.twist_body[0] == pytest.approx(x[1], abs=1e-9)
        assert np.allclose(state.covariance[np.ix_([0, 3], [0, 3])], p, rtol=0, atol=1e-9)


SHARP = {
    "mocap": {"use": True, "position_m": 1e-6, "heading_rad": 1e-6},
    "gyro": {"rate_rad_s": 1e-6},
    "gates": {"on": False},
}


def hard_steps(kind, count, seed=0):
    """Sharp and blunt measurements in turn from a vague start; least eigenvalue relative to the largest."""
    advance, compare = kernel(event_loop.advance), kernel(event_loop.compare)
    clone_pose, config = kernel(wheels.clone_pose), EstimatorConfig(kind=kind, **SHARP)
    par, points = parameters(config, WheelGeometry.nominal(), "wall")[0], points_of(config)
    sharp = kernel_parameters(tracker={"position_m": 1e-6, "heading_rad": 1e-6}).tracker
    rng = np.random.default_rng(seed)
    x, m = np.zeros(STATES), first_memory()[0]
    p = np.diag(np.maximum(prior_variances(config, "wall"), 1e-4))
    p[:6, :6] = 1e2 * np.eye(6)
    names, noise = ("mocap", "gyro", "tracker", "gyro"), 1e-6 * rng.normal(size=(1000, 3))
    worst, row = 0.0, np.zeros(1, ROW)[0]
    kernel(tracker.new_frame)(0.0, x, p, m.tracker, seen_pose(np.zeros(3)), sharp)
    for k in range(count):
        advance(x, p, 0.0025, par, points, x[3:5].copy())
        a, b, c = noise[k % 1000]
        row["mocap"] = row["tracker"] = a, b, c, 3.0, 1.0
        row["gyro"] = a, b, 0.0, 0.0
        compare(NUMBERS[names[k % 4]], k * 2.5e6, x, p, m, row, par, points)
        if k % 10 == 0:
            clone_pose(x, p)
        if k % 997 == 0 or k < 50:
            worst = min(worst, least_correlation_eigenvalue(p))
    return worst, x, p


def least_correlation_eigenvalue(p):
    size = np.sqrt(np.maximum(np.diag(p), 1e-300))
    return float(np.linalg.eigvalsh(p / np.outer(size, size))[0])


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_covariance_stays_a_covariance(kind):
    """Sharp and blunt measurements in turn from a vague start, every 2.5 ms."""
    estimator = make_estimator(EstimatorConfig(kind=kind, **SHARP), WheelGeometry.nominal(), surface="wall")
    estimator.reset(RobotState(0, np.zeros(3), np.zeros(3), 1e2 * np.eye(6)))
    rng = np.random.default_rng(0)
    for k in range(1, 2000):
        t_ns = k * 5_000_000
        a, b, c = 1e-6 * rng.normal(size=3)
        turn = GyroMeasurement(Stamp(t_ns - 2_500_000, t_ns, k), a, b, np.zeros(2))
        seen = PoseMeasurement(Stamp(t_ns, t_ns, k), "mocap", np.array([a, b, c]), 3, True)
        seen = {"mocap": (seen,)} if k % 2 else {"tracker": (replace(seen, source="tracker"),)}
        state = estimator.update(Measurements(k, t_ns, gyro=(turn,), **seen))
        assert least_correlation_eigenvalue(state.covariance) > -1e-6
        assert np.all(np.diag(state.covariance) >= 0.0)
        assert np.array_equal(state.covariance, state.covariance.T)
        assert np.all(np.isfinite(state.pose_body_in_wall))


@pytest.mark.long
@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_covariance_stays_a_covariance_for_a_million_steps(kind):
    worst, x, p = hard_steps(kind, 1_000_000)
    assert worst > -1e-6
    assert np.all(np.diag(p) >= 0.0)
    assert np.all(np.isfinite(x))


def test_the_costly_operations_are_the_products_that_they_stand_for():
    rng = np.random.default_rng(8)
    p, h = some_covariance(rng), rng.normal(size=(ROWS, STATES))
    p[5], p[:, 5] = 0.0, 0.0
    root, first = (np.full((rows, STATES), np.nan) for rows in (STATES, 6))
    small.square_root(p, root)
    assert np.array_equal(root, np.triu(root))
    assert np.allclose(root.T @ root, p, atol=1e-10)
    small.square_root(p, first)
    assert np.array_equal(first, root[:6])
    less = p.copy()
    small.downdate(less, h, 3)
    assert np.allclose(less, p - h[:3].T @ h[:3], atol=1e-12)
    cross, own = np.full((ROWS, STATES), np.nan), np.full((ROWS, ROWS), np.nan)
    small.seen(p, h, 5, cross, own)
    assert np.allclose(cross[:5], h[:5] @ p, atol=1e-12)
    assert np.allclose(own[:5, :5], h[:5] @ p @ h[:5].T, atol=1e-11)
    odd, sums = rng.normal(size=(STATES, ROWS)), np.zeros((ROWS, STATES))
    small.spread(root[:10], odd, 3, 0.7, sums)
    assert np.allclose(sums[:3], 0.7 * odd[:10, :3].T @ root[:10], atol=1e-12)
    row, corner = np.full(STATES, np.nan), np.full((6, 6), np.nan)
    small.put(row, p[0])
    small.put_rows(corner, p)
    assert np.array_equal(row, p[0])
    assert np.array_equal(corner, p[:6, :6])
    with pytest.raises(ValueError, match="20 states"):
        small.check_size(p[:6, :6])
