"""Camera, driver and alignment together give back the motion of the body."""

import math

import numpy as np
import pytest

from hil.core.geometry import between, quat_from_rotvec, quat_rotate, yaw_of_quat
from hil.core.signals import Inputs, Status
from hil.fakes.tracker.true_parameters import TrackerTruthOptions
from hil.loop.alignment import Alignment, AlignmentParameters
from hil.loop.pose_alignment import Mount
from tests.selected import every

TILTED = tuple(float(v) for v in quat_from_rotvec([0.05, -0.3, 0.2]))
WALL, FLOOR = math.pi / 2, 0.0


def aligned(bench, samples):
    config = bench.config
    mount = Mount(config.mount_position_m, config.mount_rotation_wxyz)
    alignment = Alignment(AlignmentParameters(tracker=mount))
    return alignment.measure(Inputs(0, 0, tracker=tuple(samples))).tracker


@pytest.mark.parametrize(
    ("twist", "mount", "tilt_rad"),
    every(
        5,
        [
            (twist, mount, tilt_rad)
            for twist in ((0.1, 0.0, 0.0), (0.05, 0.02, 0.4), (0.0, 0.0, -0.8))
            for mount in ((1.0, 0.0, 0.0, 0.0), TILTED)
            for tilt_rad in (FLOOR, 0.7, WALL, 3.0)
        ],
    ),
)
def test_the_alignment_gives_back_the_motion_of_the_body(
    tracker_bench, travelling_plant, follow, tilt_rad, mount, twist
):
    plant = travelling_plant(twist=twist, tilt_rad=tilt_rad)
    bench = tracker_bench(plant=plant, config={"mount_rotation_wxyz": mount})
    bench.driver.open()
    measured = aligned(bench, follow(bench, 3.0))
    assert len(measured) > 590
    start = plant.pose(measured[0].stamp.t_ns)
    for m in measured[::37]:
        np.testing.assert_allclose(m.pose, between(start, plant.pose(m.stamp.t_ns)), atol=1e-6)


@pytest.mark.parametrize(
    ("twist", "translation", "axis"),
    [
        ((0.1, 0.0, 0.0), (0, 0, -1), None),
        ((0.0, 0.1, 0.0), (-1, 0, 0), None),
        ((0.0, 0.0, 0.2), None, (0, 1, 0)),
    ],
)
def test_the_emulated_camera_has_the_axes_of_the_t265(
    tracker_bench, travelling_plant, twist, translation, axis
):
    """X right, Y up, Z back; on the floor the world starts where the camera looks (library manual)."""
    bench = tracker_bench(
        plant=travelling_plant(twist=twist, tilt_rad=FLOOR), config={"mount_position_m": (0.0, 0.0, 0.1)}
    )
    frames = []
    bench.camera.start_stream(frames.append)
    bench.clock.sleep_until_ns(2_000_000_000)
    first, last = frames[0].get_pose_data(), frames[-1].get_pose_data()
    assert (first.translation.x, first.translation.y, first.translation.z) == (0.0, 0.0, 0.0)
    assert first.rotation.w == pytest.approx(1.0)
    t_s = (frames[-1].timestamp_ms - frames[0].timestamp_ms) * 1e-3
    moved = np.array([last.translation.x, last.translation.y, last.translation.z])
    turned = np.array([last.rotation.x, last.rotation.y, last.rotation.z])
    if translation is not None:
        np.testing.assert_allclose(moved, 0.1 * t_s * np.array(translation), atol=1e-9)
        velocity = [last.velocity.x, last.velocity.y, last.velocity.z]
        np.testing.assert_allclose(velocity, 0.1 * np.array(translation), atol=1e-9)
    else:
        np.testing.assert_allclose(turned, math.sin(0.1 * t_s) * np.array(axis), atol=1e-9)
        rate = [last.angular_velocity.x, last.angular_velocity.y, last.angular_velocity.z]
        np.testing.assert_allclose(rate, 0.2 * np.array(axis), atol=1e-9)


def test_the_driver_gives_robot_axes(tracker_bench, travelling_plant, follow):
    bench = tracker_bench(
        plant=travelling_plant(twist=(0.1, 0.05, 0.3), tilt_rad=FLOOR),
        config={"mount_position_m": (0.0, 0.0, 0.0)},
    )
    bench.driver.open()
    samples = follow(bench, 2.0)
    first, last = samples[0], samples[-1]
    start, end = bench.plant.pose(300_000_000), bench.plant.pose(last.stamp.t_ns)
    moved = between(start, end)
    np.testing.assert_allclose(last.position_m, [moved[0], moved[1], 0.0], atol=1e-6)
    assert yaw_of_quat(last.quaternion_wxyz) == pytest.approx(moved[2], abs=1e-6)
    np.testing.assert_allclose(last.angular_velocity_rad_s, [0, 0, 0.3], atol=1e-9)
    np.testing.assert_allclose(
        last.velocity_m_s, quat_rotate(last.quaternion_wxyz, [0.1, 0.05, 0.0]), atol=1e-9
    )
    assert first.stamp.seq == 1


def test_gravity_lies_in_the_wall_so_that_heading_drift_tilts_the_path(
    tracker_bench, travelling_plant, follow
):
    """Yaw drift of the camera is about gravity: on the wall it is not a heading error of the robot."""
    options = TrackerTruthOptions(
        scale_sigma=0,
        yaw_walk_rad_sqrt_s=0,
        position_walk_m_sqrt_m=0,
        position_noise_m=0,
        angle_noise_rad=0,
        jitter_s=0,
        clock_ppm=0,
        yaw_rate_sigma_rad_s=0.01,
    )
    errors = {}
    for tilt_rad in (FLOOR, WALL):
        plant = travelling_plant(twist=(0.0, 0.0, 0.0), start=(0, 0, 0), tilt_rad=tilt_rad)
        bench = tracker_bench(plant=plant, options=options, seed=4)
        bench.driver.open()
        errors[tilt_rad] = abs(aligned(bench, follow(bench, 10.0))[-1].pose[2])
    assert errors[FLOOR] > 0.01
    assert errors[WALL] < 0.01 * errors[FLOOR]


def test_default_errors_are_of_the_expected_size(tracker_bench, travelling_plant, follow):
    ratios, ends = [], []
    for seed in range(6):
        plant = travelling_plant(twist=(0.1, 0.0, 0.0), start=(0, 0, 0))
        bench = tracker_bench(plant=plant, options=TrackerTruthOptions(), seed=seed)
        bench.driver.open()
        measured = [m for m in aligned(bench, follow(bench, 8.0)) if m.valid]
        moved = between(plant.pose(measured[0].stamp.t_ns), plant.pose(measured[-1].stamp.t_ns))
        error = measured[-1].pose - moved
        ends.append(error[1])
        ratios.append(error[0] / moved[0])
        assert bench.camera.odometry.scale - 1.0 == pytest.approx(ratios[-1], abs=0.01)
    assert 0.002 < np.std(ratios) < 0.012
    assert 0.0001 < np.std(ends) < 0.01


def test_confidence_grows_at_the_start_and_suffers_from_fast_motion(tracker_bench, travelling_plant, follow):
    plant = travelling_plant(twist=(0.0, 0.0, 0.0))
    bench = tracker_bench(plant=plant, options=TrackerTruthOptions())
    bench.driver.open()
    samples = follow(bench, 2.0)
    kinds = [s.status for s in samples]
    order = [Status.NOT_TRACKED, Status.LOW_CONFIDENCE, Status.OK]
    assert sorted(set(kinds), key=kinds.index) == order
    assert [kinds.count(k) for k in order[:2]] == pytest.approx([10, 30], abs=2)
    assert np.isnan(samples[0].position_m).all()
    assert {s.confidence for s in samples if s.status is Status.OK} == {2, 3}
    plant.twist = np.array([0.0, 0.0, 4.0])
    follow(bench, 0.05)
    plant.twist = np.zeros(3)
    assert Status.LOW_CONFIDENCE in {s.status for s in follow(bench, 0.3)}
    assert follow(bench, 1.0)[-1].confidence == 3
