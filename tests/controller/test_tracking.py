"""Controllers by their laws, and in closed loop on a kinematic robot with lag and slip."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.config.control import ControlConfig
from hil.controller import make_controller
from hil.controller import module_arithmetic as at
from hil.controller.laws import (
    NonlinearLaw,
    OptimalLaw,
    lag_model,
    outside_dead_zone,
    pose_error,
    riccati_gains,
)
from hil.controller.module_layer import ModuleLayer, ModuleLimits, optimize
from hil.core.errors import SafetyStop
from hil.core.geometry import compose, se2_exp
from hil.core.signals import Reference, RobotState, Stamp, WheelMeasurement
from hil.robot.kinematics import WheelGeometry, forward, wheel_vectors
from hil.robot.trajectories import circle, line
from tests.selected import draws, every

CAD, ORIGIN = WheelGeometry.nominal(), np.zeros(3)
DT = 0.01


def state(pose):
    return RobotState(0, np.asarray(pose, float), np.zeros(3), np.eye(6))


def reference(pose, twist, t_s=0.0, done=False):
    return Reference(t_s, np.asarray(pose, float), np.asarray(twist, float), np.zeros(3), done)


def wheels(steering):
    return WheelMeasurement(
        Stamp(0, 0, 0), np.zeros(4), np.zeros(4), np.asarray(steering, float), (True,) * 4
    )


def drive(
    law,
    trajectory,
    *,
    slip=(0.0, 0.0, 0.0),
    integral=True,
    feedback=lambda p: p,
    seen=lambda t_s, angles: None,
):
    """Closed loop on a kinematic robot: first-order wheels, rate-limited steering, slip in wall axes."""
    controller = make_controller(ControlConfig(law=law, integral=integral), CAD, trajectory)
    controller.reset()
    pose, rate, steering = np.zeros(3), np.zeros(4), np.zeros(4)
    errors = []
    for k in range(round((trajectory.duration_s + 2) / DT)):
        wanted = trajectory.sample(k * DT)
        setpoint = controller.update(state(feedback(pose)), wanted, wheels(steering))
        rate = rate + (setpoint.wheel_rate_rad_s - rate) * DT / 0.07
        steering = steering + np.clip(setpoint.steering_rad - steering, -0.05, 0.05)
        body = forward(CAD, rate * CAD.radius_m, steering)
        pose = compose(pose, se2_exp(body * DT))
        pose[:2] += np.asarray(slip[:2]) * DT
        errors.append(wanted.pose_in_wall - pose)
        seen(k * DT, steering)
    return np.array(errors)


@given(st.integers(0, 10_000))
def test_the_per_wheel_law_is_the_projected_twist(seed):
    """a_i, b_i of the authors' law equal P (t_d + K e)."""
    rng = np.random.default_rng(seed)
    k = rng.uniform(0.5, 5.0, 3)
    e, t = rng.normal(0, 0.1, 3), rng.normal(0, 0.1, 3)
    a = t[0] - CAD.y_m * t[2] + k[0] * e[0] - k[2] * CAD.y_m * e[2]
    b = t[1] + CAD.x_m * t[2] + k[1] * e[1] + k[2] * CAD.x_m * e[2]
    u = CAD.projection() @ NonlinearLaw(tuple(k)).twist(e, reference(np.zeros(3), t))
    np.testing.assert_allclose(u[0::2], a, atol=1e-12)
    np.testing.assert_allclose(u[1::2], b, atol=1e-12)


@given(st.integers(0, 10_000))
def test_lyapunov_function_falls_at_the_stated_rate(seed):
    rng = np.random.default_rng(seed)
    k = np.array([4.0, 4.0, 3.0])
    pose, goal = rng.normal(0, 0.2, 3), np.zeros(3)
    twist_d = np.array([0.0, 0.0, 0.0])
    h = 1e-6
    e = np.array(pose_error(state(pose), reference(goal, twist_d)))
    twist = NonlinearLaw(tuple(k)).twist(e, reference(goal, twist_d))
    after = np.array(pose_error(state(compose(pose, se2_exp(twist * h))), reference(goal, twist_d)))
    slope = (after @ after - e @ e) / 2 / h
    assert slope == pytest.approx(-e @ (k * e), rel=1e-3, abs=1e-6)


def test_eight_input_lqr_is_the_twist_lqr():
    """x' = P^+ w with R = rho I has the gains P K of the twist form with R = rho P'P."""
    p, rho, q = CAD.projection(), 0.3, np.diag([25.0, 25.0, 10.0])
    twist = [(np.eye(3), DT * np.eye(3))] * 200
    eight = [(np.eye(3), DT * np.linalg.pinv(p))] * 200
    for small, large in zip(
        riccati_gains(twist, q, rho * p.T @ p), riccati_gains(eight, q, rho * np.eye(8)), strict=True
    ):
        np.testing.assert_allclose(large, p @ small, atol=1e-9)


def test_lag_model_and_gains_against_scipy():
    from scipy.linalg import solve_discrete_are

    a, b = lag_model(0.1, DT, 0.1)
    assert a[6, 6] == pytest.approx(math.exp(-0.1))
    q, r = np.diag([25.0] * 3 + [20.0] * 3 + [1e-9] * 3), np.eye(3)
    s = solve_discrete_are(a, b, q, r)
    steady = np.linalg.solve(r + b.T @ s @ b, b.T @ s @ a)
    np.testing.assert_allclose(riccati_gains([(a, b)] * 4000, q, r)[0], steady, rtol=1e-6, atol=1e-8)
    assert np.max(np.abs(np.linalg.eigvals(a - b @ steady))) < 1.0


def test_gains_of_a_long_path_are_those_of_every_step_computed():
    """Straight for a minute, a turn, straight again: copies of the models look like others in every step."""
    straight, turn = lag_model(0.0, DT, 0.1), lag_model(0.2, DT, 0.1)
    models = [straight] * 6000 + [turn] * 300 + [straight] * 6000
    q, r = np.diag([25.0] * 3 + [20.0] * 3 + [0.0] * 3), np.eye(3)
    found = riccati_gains(models, q, r)
    computed = riccati_gains([(a.copy(), b.copy()) for a, b in models], q, r)
    np.testing.assert_allclose(found, computed, rtol=0.0, atol=1e-9)
    assert len({id(gain) for gain in found}) < 0.7 * len({id(gain) for gain in computed})


def test_module_oracles_of_wpimath():
    limits = ModuleLimits(steering_rad=3.0, flip_hysteresis_rad=0.0)
    speed, angle = optimize(1.0, 2.5, 0.0, limits)
    assert (speed, angle) == (-1.0, pytest.approx(2.5 - math.pi))
    n = np.zeros(at.SIZE)
    n[at.ASKED : at.ASKED + 4], n[at.RADIUS : at.RADIUS + 4] = [0.5, 0.3, 0.2, 0.1], 1.0
    n[at.COSINE : at.COSINE + 12] = 1.0
    at.drive(n, ModuleLimits(speed_m_s=0.28), 1.0)
    np.testing.assert_allclose(n[at.GIVEN : at.GIVEN + 4], [0.28, 0.168, 0.112, 0.056])


@given(st.floats(-3.14, 3.14), st.floats(-2.09, 2.09))
def test_a_flip_keeps_the_motion_and_never_turns_far(angle, measured):
    limits = ModuleLimits()
    speed, target = optimize(1.0, angle, measured, limits)
    same = wheel_vectors(np.full(4, speed), np.full(4, target))
    np.testing.assert_allclose(same, wheel_vectors(np.ones(4), np.full(4, angle)), atol=1e-9)
    assert abs(target) <= limits.steering_rad
    forced = abs(measured) + math.pi / 2 + limits.flip_hysteresis_rad > limits.steering_rad
    assert abs(target - measured) <= math.radians(96.0) + 1e-3 or forced


@given(st.integers(0, 10_000))
@draws(40)
def test_desaturation_keeps_the_centre_of_rotation(seed):
    twist = np.random.default_rng(seed).normal(0, 1.0, 3)
    layer = ModuleLayer(CAD, ModuleLimits(steering_rad=10.0, steering_rate_rad_s=1e6), DT)
    aligned = np.arctan2(*(CAD.projection() @ twist).reshape(4, 2).T[::-1])
    out = layer.allocate(twist, aligned)
    back = forward(CAD, out.wheel_rate_rad_s * CAD.radius_m, out.steering_rad)
    assert np.max(np.abs(out.wheel_rate_rad_s * CAD.radius_m)) <= 0.122 + 1e-12
    np.testing.assert_allclose(np.cross(back, twist), 0.0, atol=1e-9)
    assert back @ twist > 0


def slip_m_s(out, steering):
    """Largest slip of a wheel, m/s: its velocity beside the rigid-body motion that fits all wheels best."""
    u = wheel_vectors(out.wheel_rate_rad_s * CAD.radius_m, steering)
    left = (u - CAD.projection() @ np.linalg.lstsq(CAD.projection(), u, rcond=None)[0]).reshape(4, 2)
    return np.hypot(*left.T).max()


@given(st.integers(0, 10_000))
@draws(20)
def test_wheels_do_not_contradict_each_other_while_they_are_steered(seed):
    """Twists that change at once: as commanded, at the angles measured and at those just sent, no wheel
    slips by more than 5 mm/s, and the motion asked for is reached."""
    rng = np.random.default_rng(seed)
    layer, steering = ModuleLayer(CAD, ModuleLimits(), DT), np.zeros(4)
    for _ in range(2):
        twist = np.array([*rng.uniform(-0.08, 0.08, 2), rng.uniform(-0.3, 0.3)])
        for _ in range(100):
            out = layer.allocate(twist, steering)
            for angles in (steering, out.steering_rad):
                assert slip_m_s(out, angles) <= 5e-3
            steering = steering + 0.5 * (out.steering_rad - steering)
        wanted = np.hypot(*(CAD.projection() @ twist).reshape(4, 2).T)
        if wanted.min() > ModuleLimits().still_speed_m_s and wanted.max() < ModuleLimits().speed_m_s:
            reached = forward(CAD, out.wheel_rate_rad_s * CAD.radius_m, out.steering_rad)
            np.testing.assert_allclose(reached, twist, atol=1e-6)


def test_modules_arrive_together():
    layer, steering, way = ModuleLayer(CAD, ModuleLimits(), DT), np.array([0.0, 0.3, 0.0, 0.0]), []
    for _ in range(60):
        steering = layer.allocate(np.array([0.0, 0.0, 0.3]), steering).steering_rad
        way.append(steering)
    left = np.abs(np.array(way) - way[-1])
    done = [int(np.argmax(column < 1e-9)) for column in left.T]
    assert len(set(done)) == 1


def test_a_wheel_in_the_centre_of_rotation_holds_its_angle():
    twist = np.array([CAD.y_m[0], -CAD.x_m[0], 1.0]) * 0.1
    layer = ModuleLayer(CAD, ModuleLimits(), DT)
    out = layer.allocate(twist, np.array([0.7, 0.0, 0.0, 0.0]))
    assert out.wheel_rate_rad_s[0] == 0.0
    assert out.steering_rad[0] == 0.7


@pytest.mark.parametrize(
    ("law", "trajectory"),
    every(
        3,
        [
            (law, way)
            for way in (line(ORIGIN, [0.5, 0.3, 0.1]), circle(ORIGIN, 0.3, turns=0.5))
            for law in ("nonlinear", "optimal")
        ],
    ),
    ids=lambda value: value if isinstance(value, str) else value.name,
)
def test_tracks_without_slip(law, trajectory):
    errors = drive(law, trajectory)
    assert np.abs(errors[:, :2]).max() < 8e-3
    assert np.abs(errors[-1, :2]).max() < 1.5e-3
    assert abs(errors[-1, 2]) < 4e-3


def test_integral_action_beats_the_proportional_law_under_sag():
    """A slip velocity d leaves e = d / k beyond the dead zone under the non-linear law; integral action
    removes it."""
    trajectory = line(np.zeros(3), [0.0, 0.5, 0.0], duration_s=10.0)
    sag = (-2e-3, 0.0, 0.0)
    plain, optimal = drive("nonlinear", trajectory, slip=sag), drive("optimal", trajectory, slip=sag)
    moving = slice(200, 900)
    assert plain[moving, 0].mean() == pytest.approx(2e-3 / 4.0 + ControlConfig().dead_zone[0], rel=0.1)
    rms = [np.sqrt(np.mean(e[:, 0] ** 2)) for e in (plain, optimal)]
    assert rms[1] <= 0.7 * rms[0]


def controller_of(**given):
    return make_controller(ControlConfig(**given), CAD, line(np.zeros(3), [0.5, 0, 0], duration_s=5.0))


def asked_after(waiting, **given):
    """Forward speed, m/s, asked for 1.5 mm behind the end, after `waiting(controller)` in 20 s of cycles."""
    controller = controller_of(**given)
    for _ in range(2000):
        waiting(controller)
    end = reference([0.5, 0, 0], [0, 0, 0], 5.0, done=True)
    out = controller.update(state([0.4985, 0, 0]), end, wheels(np.zeros(4)))
    return float(forward(CAD, out.wheel_rate_rad_s * CAD.radius_m, out.steering_rad)[0])


def at_the_goal(controller):
    end = reference([0.5, 0, 0], [0, 0, 0], 5.0, done=True)
    out = controller.update(state([0.4991, 0, 0]), end, wheels(np.zeros(4)))
    assert not out.wheel_rate_rad_s.any()


def at_the_limit(controller):
    controller.update(state([0.3, 0, 0]), reference([0.5, 0, 0], [0, 0, 0], 5.0), wheels(np.zeros(4)))


def steering(controller):
    controller.update(state([0.49, 0, 0]), reference([0.5, 0, 0], [0, 0, 0], 5.0), wheels(np.full(4, 1.2)))


@pytest.mark.parametrize("waiting", [at_the_goal, at_the_limit, steering])
def test_the_integral_does_not_grow_while_the_wheels_cannot_follow(waiting):
    """Held at the goal, at the limit of speed, or with modules that do not turn: nothing is let loose."""
    assert asked_after(waiting) == pytest.approx(asked_after(waiting, integral_clamp=1e-4), rel=0.01)


def test_the_integral_is_bounded_by_what_a_wall_can_do():
    """A robot that drives and does not move: 29 mm/s beside the proportional part, and no more."""

    def driving(controller):
        controller.update(state([0.49, 0, 0]), reference([0.5, 0, 0], [0, 0, 0], 5.0), wheels(np.zeros(4)))

    assert asked_after(driving) - asked_after(driving, integral_clamp=1e-4) == pytest.approx(0.029, abs=2e-3)


def test_optimal_law_without_integral_still_tracks():
    errors = drive("optimal", line(np.zeros(3), [0.5, 0, 0]), integral=False)
    assert np.abs(errors[-1, :2]).max() < 2e-3


@given(st.lists(st.floats(-1e-2, 1e-2), min_size=3, max_size=3))
def test_the_dead_zone_is_continuous_and_never_overshoots(error):
    error, zone = np.array(error), np.array([1e-4, 1e-4, 5e-4])
    left = np.array(outside_dead_zone(error, zone))
    assert np.all(np.abs(error - left) <= zone + 1e-15)
    assert np.all(left * error >= 0.0)
    np.testing.assert_array_equal(left[np.abs(error) <= zone], 0.0)
    np.testing.assert_allclose(outside_dead_zone(error + 1e-9, zone), left, atol=1.001e-9)


@pytest.mark.parametrize("law", ["nonlinear", "optimal"])
def test_encoder_noise_does_not_steer_a_slow_wheel(law):
    """Start of a line, millimetres per second: noise of one encoder step would swing wheels by degrees."""
    rng = np.random.default_rng(3)
    trajectory, steering = line(np.zeros(3), [0.5, 0, 0]), []

    def noisy(pose):
        return pose + rng.uniform(-4e-5, 4e-5, 3)

    drive(law, trajectory, feedback=noisy, seen=lambda t_s, angles: steering.append((t_s, *angles)))
    early = np.array([row[1:] for row in steering if row[0] < 1.0])
    assert np.abs(early).max() < np.radians(0.1)


def test_at_the_goal_the_robot_is_held():
    trajectory = line(np.zeros(3), [0.5, 0, 0])
    controller = make_controller(ControlConfig(), CAD, trajectory)
    end = trajectory.sample(1e3)
    out = controller.update(state([0.4995, 0, 0]), end, wheels([0.1, 0.2, 0.3, 0.4]))
    np.testing.assert_array_equal(out.wheel_rate_rad_s, 0.0)
    np.testing.assert_array_equal(out.steering_rad, [0.1, 0.2, 0.3, 0.4])


@pytest.mark.parametrize("bad", ["state", "reference", "gains"])
def test_nonsense_stops_the_robot(bad):
    trajectory = line(np.zeros(3), [0.5, 0, 0])
    gains = (math.nan, 4.0, 3.0) if bad == "gains" else (4.0, 4.0, 3.0)
    controller = make_controller(
        ControlConfig.model_construct(**{**ControlConfig().model_dump(), "law": "nonlinear", "gains": gains}),
        CAD,
        trajectory,
    )
    pose = [math.nan, 0, 0] if bad == "state" else [0, 0, 0]
    goal = [math.nan, 0, 0] if bad == "reference" else [0.1, 0, 0]
    with pytest.raises(SafetyStop, match="not_finite"):
        controller.update(state(pose), reference(goal, [0, 0, 0]), wheels(np.zeros(4)))


def test_optimal_law_resets():
    law = OptimalLaw(lambda t: 0.0, 1.0, dt_s=DT, lag_s=0.1, weights=(25.0, 20.0, 1.0), clamp=0.1)
    first = law.twist(np.array([0.01, 0, 0]), reference(np.zeros(3), np.zeros(3)))
    law.twist(np.array([0.01, 0, 0]), reference(np.zeros(3), np.zeros(3), 0.01))
    law.reset()
    np.testing.assert_array_equal(
        first, law.twist(np.array([0.01, 0, 0]), reference(np.zeros(3), np.zeros(3)))
    )
