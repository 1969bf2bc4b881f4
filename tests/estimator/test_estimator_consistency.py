"""How sure the filters are against how wrong they are: Monte Carlo, smoother, checks of the checks."""

import numpy as np
import pytest
from estimator_drives import drive

from hil.config.estimator import EstimatorConfig
from hil.core.signals import Measurements, PoseMeasurement, RobotState, Stamp
from hil.estimator import constant_twist, event_loop, kalman_update, make_estimator, process_model, sensors
from hil.estimator.kalman_update import Compared
from hil.estimator.kernel_layout import ROW, first_memory, parameters
from hil.estimator.matrix_loops import square_root
from hil.estimator.nees import autocorrelation, band, nees, whiteness
from hil.estimator.sensors import NUMBERS, tracker, wheels
from hil.estimator.sigma_points import points_of
from hil.estimator.smoother import smooth
from hil.estimator.state_vector import CLONE, MOTION, POSE, ROWS, SCALE, STATES, V_X, V_Y, prior_variances
from hil.robot.kinematics import WheelGeometry
from hil.support.numba_jit import kernel
from tests.selected import every

advance, moments, predicted = (
    kernel(event_loop.advance),
    kernel(event_loop.moments),
    kernel(sensors.predicted),
)
move, add_noise = kernel(constant_twist.move), kernel(process_model.add_noise)
condition, joint_nis = kernel(kalman_update.condition), kernel(kalman_update.joint_nis)
clone_pose = kernel(wheels.clone_pose)

DT_S = 0.01
VARIANCE = {
    "wheels": np.full(8, (1e-4) ** 2),
    "gyro": np.array([0.003**2, 0.02**2]),
    "tracker": np.array([1.5e-3**2, 1.5e-3**2, 3e-3**2]),
}


class World:
    """A truth drawn from the filter's own model, and the filter that follows it."""

    def __init__(self, kind, seed, heading_sigma=0.02):
        config = EstimatorConfig(kind=kind)
        self.par, self.points = parameters(config, WheelGeometry.nominal(), "wall")[0], points_of(config)
        self.rng = np.random.default_rng(seed)
        self.x, self.p = np.zeros(STATES), np.diag(prior_variances(config, "wall"))
        self.x[V_X] = 0.1
        sigma = np.array([5e-3, 5e-3, heading_sigma, 0.01, 0.01, 0.05])
        self.p[:MOTION, :MOTION] = np.diag(sigma**2)
        close = EstimatorConfig(tracker={"position_m": 1e-3, "heading_rad": 1e-3})
        close_par = parameters(close, WheelGeometry.nominal(), "wall")[0].tracker
        memory = first_memory()[0].tracker
        tracker.new_frame(0.0, self.x, self.p, memory, np.zeros(1, ROW)[0].tracker, close_par)
        clone_pose(self.x, self.p)
        self.true = self.x + self.drawn(self.p)
        self.nis = {sensor: [] for sensor in VARIANCE}

    def drawn(self, p):
        """One error (20,) of this covariance."""
        root = np.zeros((STATES, STATES))
        square_root(p, root)
        return self.rng.normal(size=STATES) @ root

    def step(self):
        noise = np.zeros((STATES, STATES))
        add_noise(self.true, noise, DT_S, self.par.process)
        rolling = self.x[V_X : V_Y + 1].copy()
        move(self.true, DT_S, self.par.process.slip_s, 1.0, self.x[SCALE], self.true[V_X : V_Y + 1].copy())
        self.true += self.drawn(noise)
        advance(self.x, self.p, DT_S, self.par, self.points, rolling)

    def sense(self, sensor):
        number, count = NUMBERS[sensor], len(VARIANCE[sensor])
        aux = np.array([DT_S, 0.1 * DT_S, 0.1 * DT_S, 0.0, 0.0])
        z, nu, work = np.zeros(ROWS), np.zeros(ROWS), self.par.work
        predicted(number, self.true, aux, self.par, z)
        z[:count] += np.sqrt(VARIANCE[sensor]) * self.rng.normal(size=count)
        var = np.zeros(ROWS)
        var[:count] = VARIANCE[sensor]
        work.aux[:] = aux
        moments(number, self.x, self.p, self.par, self.points, count)
        nu[:count] = (z - work.mean)[:count]
        rows = Compared(nu, work.cross.copy(), work.own.copy(), var, np.zeros(ROWS))
        self.nis[sensor].append(joint_nis(rows, count))
        condition(self.x, self.p, rows, count, np.inf)
        if sensor == "wheels":
            clone_pose(self.x, self.p)
            self.true[CLONE] = self.true[POSE]

    def nees(self):
        return float(nees((self.true - self.x)[None, :3], self.p[None, :3, :3])[0])


def monte_carlo(kind, runs, steps=150):
    """NEES after a third, two thirds and all steps, and mean NIS per sensor, averaged over runs."""
    errors, innovations = [], {k: [] for k in VARIANCE}
    for seed in range(runs):
        world, found = World(kind, seed), []
        for k in range(1, steps + 1):
            world.step()
            world.sense("wheels")
            world.sense("gyro")
            if k % 2 == 0:
                world.sense("tracker")
            if k % (steps // 3) == 0:
                found.append(world.nees())
        errors.append(found)
        for sensor, values in world.nis.items():
            innovations[sensor].append(np.mean(values))
    return np.mean(errors, axis=0), {k: (np.mean(v), len(world.nis[k])) for k, v in innovations.items()}


def assert_consistent(kind, runs):
    errors, innovations = monte_carlo(kind, runs)
    low, high = band(3, runs)
    assert np.all((low <= errors) & (errors <= high)), (errors, low, high)
    for sensor, (value, samples) in innovations.items():
        low, high = band(len(VARIANCE[sensor]), runs * samples)
        assert low <= value <= high, (sensor, value, low, high)


@pytest.mark.parametrize("kind", every(2, ["ekf", "ukf"]))
def test_nees_and_nis_lie_in_the_95_percent_band(kind):
    assert_consistent(kind, runs=100)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_nees_and_nis_lie_in_the_95_percent_band_of_many_runs(kind):
    assert_consistent(kind, runs=400)


def start_up_nees(kind, sigma, runs=100):
    """A metre driven with a heading known to `sigma` only, then one position good to 5 mm: mean NEES."""
    config = EstimatorConfig(
        kind=kind,
        gates={"on": False},
        mocap={"use": True, "position_m": 5e-3, "heading_rad": 10.0},
        process={"acceleration_m_s2_sqrt_hz": 1e-6, "angular_acceleration_rad_s2_sqrt_hz": 1e-6},
    )
    found = []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        estimator = make_estimator(config, WheelGeometry.nominal(), surface="floor")
        theta = sigma * rng.normal()
        start = np.diag([1e-6, 1e-6, sigma**2, 1e-10, 1e-10, 1e-10])
        estimator.reset(RobotState(0, np.zeros(3), np.array([0.5, 0.0, 0.0]), start))
        where = np.array([np.cos(theta), np.sin(theta), theta])
        z = where + np.array([5e-3, 5e-3, 10.0]) * rng.normal(size=3)
        seen = PoseMeasurement(Stamp(2 * 10**9, 2 * 10**9, 0), "mocap", z, 3, True)
        state = estimator.update(Measurements(0, 2 * 10**9, mocap=(seen,)))
        found.append(nees((state.pose_body_in_wall - where)[None], state.covariance[None, :3, :3])[0])
    return np.mean(found)


@pytest.mark.parametrize("sigma", [0.02, 0.1])
def test_one_position_finds_a_heading_that_was_not_known(sigma):
    """Only the heading is drawn, so that a consistent filter has a mean of 1 here (an additive EKF: 18)."""
    assert 0.6 < start_up_nees("ekf", sigma) < 2.0
    assert 0.6 < start_up_nees("ukf", sigma) < 3.0


def test_the_smoother_is_the_batch_solution_on_a_linear_chain():
    """Straight motion with known heading: every position given all measurements, by least squares."""
    q, r, dt, n = 0.3, 0.05, 0.1, 30
    config = EstimatorConfig(
        process={"acceleration_m_s2_sqrt_hz": q, "angular_acceleration_rad_s2_sqrt_hz": 1e-9},
        gates={"on": False},
        mocap={"use": True, "position_m": r, "heading_rad": 10.0},
    )
    rng, cycles, zs = np.random.default_rng(3), [], []
    for k in range(1, n + 1):
        t_ns = round(k * dt * 1e9)
        zs.append(0.1 * k * dt + r * rng.normal())
        seen = PoseMeasurement(Stamp(t_ns, t_ns, k), "mocap", np.array([zs[-1], 0.0, 0.0]), 3, True)
        cycles.append(Measurements(k, t_ns, mocap=(seen,)))
    start = RobotState(0, np.zeros(3), np.zeros(3), np.diag([0.2**2, 1e-20, 0, 0.1**2, 0, 0]))
    states = smooth(config, WheelGeometry.nominal(), "floor", cycles, start)

    f, noise = np.array([[1, dt], [0, 1]]), q * q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    information, vector = np.zeros((2 * n + 2, 2 * n + 2)), np.zeros(2 * n + 2)
    information[:2, :2] += np.diag([1 / 0.2**2, 1 / 0.1**2])
    for k in range(n):
        a = np.zeros((2, 2 * n + 2))
        a[:, 2 * k : 2 * k + 2], a[:, 2 * k + 2 : 2 * k + 4] = -f, np.eye(2)
        information += a.T @ np.linalg.inv(noise) @ a
        information[2 * k + 2, 2 * k + 2] += 1 / r**2
        vector[2 * k + 2] += zs[k] / r**2
    covariance = np.linalg.inv(information)
    batch = (covariance @ vector).reshape(-1, 2)
    for k, state in enumerate(states, start=1):
        assert state.pose_body_in_wall[0] == pytest.approx(batch[k, 0], abs=1e-9)
        assert state.twist_body[0] == pytest.approx(batch[k, 1], abs=1e-8)
        assert state.covariance[0, 0] == pytest.approx(covariance[2 * k, 2 * k], rel=1e-7)


def test_the_smoother_beats_the_filter_and_agrees_with_it_at_the_end():
    """Clones and anchors included; with outliers and a lost wheel it stays a covariance."""
    improved = []
    for seed in range(6):
        d = drive(seconds=3.0, seed=seed, outliers=seed > 3)
        config = EstimatorConfig()
        estimator = make_estimator(config, WheelGeometry.nominal(), surface="wall")
        vague = np.diag([1e-6] * 3 + [0.1] * 3)
        start = RobotState(d.start.t_ns, d.start.pose_body_in_wall, np.zeros(3), vague)
        estimator.reset(start)
        filtered = [estimator.update(m) for m in d.measurements]
        states = smooth(config, WheelGeometry.nominal(), "wall", d.measurements, start)
        t_s = np.array([m.t_ns for m in d.measurements]) * 1e-9
        truth = d.path.at(t_s)

        def squares(of, truth=truth):
            error = np.array([s.pose_body_in_wall for s in of]) - truth
            return np.mean(np.sum(error[:, :2] ** 2, axis=1)), np.mean(error[:, 2] ** 2)

        improved.append([squares(filtered), squares(states)])
        late = [
            s.covariance[2, 2] <= f.covariance[2, 2] * (1 + 1e-9)
            for s, f in zip(states[:-10], filtered, strict=False)
        ]
        assert np.mean(late) > 0.99
        assert np.linalg.eigvalsh(np.array([s.covariance for s in states])).min() > -1e-12
        assert np.allclose(states[-1].pose_body_in_wall, filtered[-1].pose_body_in_wall, atol=1e-3)
    before, after = np.mean(improved[:4], axis=0)
    assert np.all(after < before)


def test_checks_of_consistency():
    rng = np.random.default_rng(4)
    a = rng.normal(size=(3, 3))
    covariance = a @ a.T
    error = rng.normal(size=(20_000, 3)) @ a.T
    values = nees(error, np.repeat(covariance[None], len(error), axis=0))
    assert np.mean(values) == pytest.approx(3.0, rel=0.03)
    assert np.isnan(nees(np.array([[np.nan, 0, 0]]), covariance[None])[0])
    low, high = band(3, 100)
    assert low < 3.0 < high
    assert high - low == pytest.approx(4 * np.sqrt(6.0 / 100), rel=0.03)
    white = rng.normal(size=4000)
    assert whiteness(white) > 0.01
    assert np.max(np.abs(autocorrelation(white))) < 5 / np.sqrt(4000)
    coloured = np.convolve(white, np.ones(5) / 5, mode="valid")
    assert whiteness(coloured) < 1e-6
    assert autocorrelation(coloured)[0] == pytest.approx(0.8, abs=0.05)
