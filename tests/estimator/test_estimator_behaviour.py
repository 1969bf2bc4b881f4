"""What the filter does on the wall and when sensors fail: sag, slip, gates, clocks, start-up."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest
from estimator_drives import drive
from simulated_sensors import (
    CameraErrors,
    InertialErrors,
    Path,
    camera,
    cycles,
    inertial,
    start_state,
    wheel_samples,
)

from hil.config.estimator import EstimatorConfig
from hil.core.signals import PoseMeasurement, Stamp
from hil.estimator import make_estimator
from hil.estimator.measurement_queue import SensorClock
from hil.robot.kinematics import WheelGeometry

ROOT = FilePath(__file__).parents[2]
EKF = EstimatorConfig()


def on_the_wall(seconds, speed_m_s, sag_m_s, creep, seed, heading=np.pi / 2):
    """Wheels that report `speed_m_s` in the body's x direction; truth sags and creeps down on top."""
    rng = np.random.default_rng(seed)
    t_s = 1.0 + np.arange(round(seconds * 100) + 1) / 100.0
    rolled = speed_m_s * (t_s - 1.0)
    x = np.cos(heading) * rolled - sag_m_s * (t_s - 1.0) - creep * np.abs(rolled)
    path = Path(t_s, np.column_stack([x, np.sin(heading) * rolled, np.full_like(t_s, heading)]))
    angle = np.repeat(rolled[:, None] / 0.0254, 4, axis=1)
    angle = np.round(angle / (2 * np.pi / 4096)) * (2 * np.pi / 4096)
    wheels = wheel_samples(t_s, angle, np.zeros((len(t_s), 4)), np.full((len(t_s), 4), speed_m_s / 0.0254))
    gyro = inertial(path, InertialErrors(), rng, on_wall=True)
    tracker = camera(path, CameraErrors(), rng)
    begin_ns = round(t_s[0] * 1e9) - 1
    return path, wheels, gyro, tracker, start_state(begin_ns, path.pose[0]), round(t_s[-1] * 1e9)


def follow(config, scene, tracker=None, surface="wall"):
    path, wheels, gyro, seen, start, end_ns = scene
    estimator = make_estimator(config, WheelGeometry.nominal(), surface=surface)
    estimator.reset(start)
    parts = cycles(start.t_ns + 10_000_000, end_ns, wheels, gyro, seen if tracker is None else tracker)
    state = None
    for m in parts:
        state = estimator.update(m)
    return state, state.pose_body_in_wall - path.at(np.array([state.t_ns * 1e-9]))[0]


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_sag_is_found_with_the_camera(kind):
    for seed in range(2):
        state, _ = follow(EstimatorConfig(kind=kind), on_the_wall(10.0, 0.0, 2e-3, 0.0, seed))
        assert state.diagnostics["sag_m_s"] == pytest.approx(2e-3, rel=0.2)
        assert state.diagnostics["sag_sigma_m_s"] < 0.5 * EKF.wall.slip_m_s


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_without_camera_sag_is_not_claimed_to_be_known(kind):
    """Wheels at rest say nothing of sag: its sigma stays at the prior, and the position's grows with it."""
    state, error = follow(EstimatorConfig(kind=kind), on_the_wall(10.0, 0.0, 2e-3, 0.0, 0), tracker=())
    assert state.diagnostics["sag_sigma_m_s"] > 0.95 * EKF.wall.slip_m_s
    assert abs(error[0]) < 3.0 * np.sqrt(state.covariance[0, 0])
    assert np.sqrt(state.covariance[0, 0]) > 0.005


@pytest.mark.parametrize(("sag_m_s", "creep"), [(0.0, 0.04), (2e-3, 0.0)])
def test_camera_lost_for_ten_seconds_after_slip_was_learnt(sag_m_s, creep):
    scene = on_the_wall(30.0, 0.05, sag_m_s, creep, 1)
    lost_ns = scene[-1] - 10_000_000_000
    seen = tuple(c for c in scene[3] if c.stamp.t_ns < lost_ns)
    state, error = follow(EKF, scene, tracker=seen)
    assert np.hypot(*error[:2]) <= 0.015
    assert state.diagnostics["age_tracker_s"] == pytest.approx(10.0, abs=0.1)
    without, worse = follow(EKF, scene, tracker=())
    assert np.hypot(*error[:2]) < 0.5 * np.hypot(*worse[:2])
    assert without.covariance[0, 0] > state.covariance[0, 0]


def test_gravity_holds_the_heading_on_the_wall_only():
    """The same stream in both modes: on the floor the gyro's bias and the wheels are all there is."""
    scene = on_the_wall(20.0, 0.05, 0.0, 0.0, 2)
    wall, error = follow(EKF, scene, tracker=())
    floor, _ = follow(EKF, scene, tracker=(), surface="floor")
    assert abs(error[2]) < np.deg2rad(0.6)
    assert floor.covariance[2, 2] > 4.0 * wall.covariance[2, 2]
    assert wall.diagnostics["nis_mean_gravity"] < 2.0


def test_one_slipping_wheel_is_gated_alone():
    scene = on_the_wall(6.0, 0.05, 0.0, 0.0, 3)
    wheels = tuple(
        replace(w, wheel_angle_rad=w.wheel_angle_rad + np.array([0.0, 0.0, 0.02 * max(0, k - 300), 0.0]))
        for k, w in enumerate(scene[1])
    )
    state, error = follow(EKF, (scene[0], wheels, *scene[2:]))
    d = state.diagnostics
    assert d["rejected_wheel_br"] > 50
    assert d["rejected_wheel_br"] > 5 * max(d[f"rejected_wheel_{w}"] for w in ("fl", "bl", "fr"))
    assert np.hypot(*error[:2]) < 0.005


def test_no_sensor_is_locked_out_for_ever():
    """A camera that jumps is re-anchored at once; one that leans slowly away is let in again."""
    scene = on_the_wall(12.0, 0.0, 0.0, 0.0, 4)
    jumped = tuple(
        replace(c, pose=c.pose + np.array([0.1, -0.05, 0.2]) * (k > 1000)) for k, c in enumerate(scene[3])
    )
    state, error = follow(EKF, scene, tracker=jumped)
    assert state.diagnostics["reanchored_tracker"] == 1
    assert np.hypot(*error[:2]) < 0.005
    leaning = tuple(
        replace(c, pose=c.pose + np.array([1e-4, 0.0, 0.0]) * min(max(0, k - 400), 800))
        for k, c in enumerate(scene[3])
    )
    state, error = follow(EKF, scene, tracker=leaning)
    assert state.diagnostics["rejected_tracker"] > 0
    assert state.diagnostics["reanchored_tracker"] >= 1
    accepted_again = abs(state.diagnostics["innovation_tracker_m"]) < 0.01
    assert accepted_again
    assert np.all(np.isfinite(error))


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_poses_that_were_refused_until_the_frame_began_anew_leave_the_estimate_unsure(kind):
    """Who is right is not known: what camera and wheels differed by is not forgotten with the old frame."""
    scene = on_the_wall(6.0, 0.05, 0.0, 0.0, 4)
    away = tuple(
        replace(c, pose=c.pose - np.array([2e-4, 0.0, 0.0]) * min(max(0, k - 200), 400))
        for k, c in enumerate(scene[3])
    )
    state, _ = follow(EstimatorConfig(kind=kind), scene, tracker=away)
    sigma_m = np.sqrt(np.diag(state.covariance)[:2])
    assert state.diagnostics["reanchored_tracker"] >= 1
    assert np.all(sigma_m > 0.005)
    honest, _ = follow(EstimatorConfig(kind=kind), scene)
    assert np.all(np.sqrt(np.diag(honest.covariance)[:2]) < 0.003)


def test_motion_capture_that_was_refused_for_long_is_believed_in_the_end():
    config = EstimatorConfig(mocap={"use": True})
    path, wheels, gyro, seen, start, _ = on_the_wall(4.0, 0.05, 0.0, 0.0, 3)
    estimator = make_estimator(config, WheelGeometry.nominal(), surface="wall")
    estimator.reset(start)
    end_ns = start.t_ns + 4_000_000_000
    poses = []
    for k in range(1, 400):
        t_ns = start.t_ns + 10_000_000 * k
        moved = np.array([0.3, 0.0, 0.0]) if k > 150 else np.zeros(3)
        pose = path.at(np.array([t_ns * 1e-9]))[0] + moved
        poses.append(PoseMeasurement(Stamp(t_ns, t_ns, k), "mocap", pose, 3, True))
    for m in cycles(start.t_ns + 10_000_000, end_ns, wheels, gyro, seen, poses):
        state = estimator.update(m)
    error = state.pose_body_in_wall - path.at(np.array([state.t_ns * 1e-9]))[0]
    assert error[0] == pytest.approx(0.3, abs=0.005)


def test_confidence_zero_and_one_are_dropped_and_two_is_trusted_less():
    scene = on_the_wall(4.0, 0.0, 0.0, 0.0, 5)
    sigma = {}
    for quality in (1, 2, 3):
        seen = tuple(replace(c, quality=quality) for c in scene[3])
        state, _ = follow(EKF, scene, tracker=seen)
        sigma[quality] = state.covariance[0, 0]
        assert (state.diagnostics["rejected_tracker"] > 0.9 * len(seen)) == (quality == 1)
    assert sigma[1] > sigma[2] > sigma[3]


def test_a_dropout_widens_the_covariance_and_shows_as_age():
    scene = on_the_wall(10.0, 0.05, 0.0, 0.0, 6)
    half_ns = 5_500_000_000
    path, wheels, gyro, _, *rest = scene
    dead = (path, tuple(w for w in wheels if w.stamp.t_ns < half_ns), gyro, (), *rest)
    state, error = follow(EKF, dead)
    whole, _ = follow(EKF, scene, tracker=())
    assert state.diagnostics["age_wheels_s"] > 5.0
    assert state.covariance[0, 0] > 2.0 * whole.covariance[0, 0]
    assert abs(error[1]) < 4.0 * np.sqrt(state.covariance[1, 1])


def test_a_wheel_gap_longer_than_allowed_is_not_one_displacement():
    config = EstimatorConfig(wheels={"longest_gap_s": 0.1})
    scene = on_the_wall(6.0, 0.05, 0.0, 0.0, 7)
    thin = tuple(w for w in scene[1] if not 3.0 < w.stamp.t_ns * 1e-9 < 3.5)
    state, error = follow(config, (scene[0], thin, *scene[2:]))
    whole, _ = follow(config, scene)
    assert state.diagnostics["rejected_wheels"] == whole.diagnostics["rejected_wheels"]
    assert np.hypot(*error[:2]) < 0.005


def test_clock_drift_and_offset_are_followed():
    """55 ms in 65 min and receive jitter to 200 ms: the correction is right to 2 ms after five minutes."""
    rng = np.random.default_rng(8)
    clock, drift = SensorClock(), 55e-3 / 3900.0
    for k in range(20 * 600):
        t_s = k / 20.0
        late_s = 0.002 + min(0.2, rng.exponential(0.01))
        clock.add(round((t_s * (1.0 - drift)) * 1e9), round((t_s + late_s) * 1e9))
    assert clock.drift == pytest.approx(drift, rel=0.2)
    assert clock.correction_ns(round(600e9 * (1 - drift))) == pytest.approx(600.0 * drift * 1e9, abs=2e6)


def test_estimated_clocks_correct_what_a_drifting_clock_does():
    scene = on_the_wall(30.0, 0.05, 0.0, 0.0, 9)
    begin_ns, end_ns = scene[4].t_ns, scene[5]

    def drifting(c):
        behind = round(0.2e9 * (c.stamp.t_ns - begin_ns) / (end_ns - begin_ns))
        return replace(c, stamp=replace(c.stamp, t_ns=c.stamp.t_ns - behind))

    seen = tuple(drifting(c) for c in scene[3])
    _, plain = follow(EKF, scene, tracker=seen)
    _, corrected = follow(EstimatorConfig(time={"clock": "estimated"}), scene, tracker=seen)
    _, reference = follow(EKF, scene)
    assert np.hypot(*(corrected - reference)[:2]) < 0.3 * np.hypot(*(plain - reference)[:2])


@pytest.mark.parametrize(
    "changes",
    [
        {"process": {"acceleration_m_s2_sqrt_hz": -0.1}},
        {"mocap": {"position_m": 0.0}},
        {"alpha": float("nan")},
    ],
)
def test_impossible_noise_is_refused(changes):
    with pytest.raises(ValueError, match=r"process|mocap|alpha"):
        EstimatorConfig(**changes)


RUN = """
import sys
sys.path.insert(0, {here!r})
import numpy as np
from estimator_drives import drive
from hil.config.estimator import EstimatorConfig
from hil.estimator import make_estimator
from hil.robot.kinematics import WheelGeometry
d = drive(seconds=0.4, seed=1, outliers=True)
for kind in ("ekf", "ukf"):
    e = make_estimator(EstimatorConfig(kind=kind), WheelGeometry.nominal(), surface="wall")
    e.reset(d.start)
    for m in d.measurements:
        s = e.update(m)
    print(" ".join(repr(float(v)) for v in (*s.pose_body_in_wall, *s.covariance.ravel())))
"""


def in_process(**environment):
    script = RUN.format(here=str(FilePath(__file__).parent))
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        timeout=600,
        cwd=ROOT,
        env={**os.environ, **environment},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return np.array([[float(v) for v in line.split()] for line in done.stdout.splitlines()])


@pytest.mark.long
def test_without_machine_code_the_results_are_the_same():
    plain = in_process(NUMBA_DISABLE_JIT="1")
    cycles_ = drive(seconds=0.4, seed=1, outliers=True)
    for kind, values in zip(("ekf", "ukf"), plain, strict=True):
        estimator = make_estimator(EstimatorConfig(kind=kind), WheelGeometry.nominal(), surface="wall")
        estimator.reset(cycles_.start)
        for m in cycles_.measurements:
            state = estimator.update(m)
        assert np.allclose(state.pose_body_in_wall, values[:3], rtol=0, atol=1e-10)
        assert np.allclose(state.covariance.ravel(), values[3:], rtol=0, atol=1e-10)


@pytest.mark.long
def test_a_cold_start_compiles_and_runs(tmp_path):
    """An empty cache folder, as on a first start: everything is compiled, nothing is assumed."""
    values = in_process(NUMBA_CACHE_DIR=str(tmp_path))
    assert np.all(np.isfinite(values))
    assert any(tmp_path.rglob("*.nbc"))
