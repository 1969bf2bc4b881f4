"""Computer, driver and alignment together give back the motion of the body, whatever the frames."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from following import follow

from hil.core.geometry import between, quat_from_rotvec, quat_rotate, yaw_of_quat
from hil.core.signals import Inputs, Status
from hil.fakes.tracker.mavlink.chip import IDEAL, ComputerTruthOptions
from hil.links.mavlink import messages as odometry_messages
from hil.loop.alignment import Alignment, AlignmentParameters, Mount
from tests.selected import every

pytest.importorskip("pymavlink", reason="the extra mavlink is not installed")

TILTED = tuple(float(v) for v in quat_from_rotvec([0.05, -0.3, 0.2]))
WALL, FLOOR = math.pi / 2, 0.0
FRAMES = list(itertools.product(("LOCAL_FRD", "LOCAL_FLU", "LOCAL_NED", "LOCAL_ENU"), (True, False)))


def aligned(bench, samples):
    mount = Mount(bench.config.mount_position_m, bench.config.mount_rotation_wxyz)
    return Alignment(AlignmentParameters(tracker=mount)).measure(Inputs(0, 0, tracker=tuple(samples))).tracker


@pytest.mark.parametrize(
    ("frame", "in_body", "tilt_rad"), every(3, [(*frame, tilt) for frame in FRAMES for tilt in (FLOOR, WALL)])
)
def test_the_alignment_gives_back_the_motion_of_the_body(
    mavlink_bench, travelling_plant, tilt_rad, frame, in_body
):
    plant = travelling_plant(twist=(0.05, 0.02, 0.4), tilt_rad=tilt_rad)
    options = dataclasses.replace(IDEAL, frame=frame, twist_in_body=in_body)
    bench = mavlink_bench(plant=plant, options=options, config={"mount_rotation_wxyz": TILTED})
    bench.driver.open()
    samples = follow(bench, 2.0)
    measured = aligned(bench, samples)
    assert len(measured) > 190
    start = plant.pose(measured[0].stamp.t_ns)
    for m in measured[::37]:
        np.testing.assert_allclose(m.pose, between(start, plant.pose(m.stamp.t_ns)), atol=2e-6)


@pytest.mark.parametrize("in_body", [True, False])
def test_pose_and_twist_are_in_the_robot_axes_of_the_start(mavlink_bench, travelling_plant, in_body):
    bench = mavlink_bench(
        plant=travelling_plant(twist=(0.1, 0.05, 0.3), tilt_rad=FLOOR),
        config={"mount_position_m": (0.0, 0.0, 0.0)},
        options=dataclasses.replace(IDEAL, twist_in_body=in_body),
    )
    bench.driver.open()
    last = follow(bench, 2.0)[-1]
    moved = between(bench.plant.pose(300_000_000), bench.plant.pose(last.stamp.t_ns))
    np.testing.assert_allclose(last.position_m, [moved[0], moved[1], 0.0], atol=1e-6)
    assert yaw_of_quat(last.quaternion_wxyz) == pytest.approx(moved[2], abs=1e-6)
    np.testing.assert_allclose(last.angular_velocity_rad_s, [0, 0, 0.3], atol=1e-6)
    there = quat_rotate(last.quaternion_wxyz, [0.1, 0.05, 0.0])
    np.testing.assert_allclose(last.velocity_m_s, there, atol=1e-6)
    assert last.confidence == 3


def test_covariances_come_through_and_grow_with_the_way(mavlink_bench, travelling_plant):
    options = dataclasses.replace(
        IDEAL,
        position_noise_m=0.001,
        angle_noise_rad=0.002,
        velocity_noise_m_s=0.003,
        rate_noise_rad_s=0.004,
        position_walk_m_sqrt_m=0.01,
    )
    bench = mavlink_bench(plant=travelling_plant(twist=(0.1, 0.0, 0.0)), options=options)
    bench.driver.open()
    last = follow(bench, 3.0)[-1]
    message = bench.driver._session.last
    axes = odometry_messages.axes_of(message.frame_id, message.child_frame_id)
    sigma = np.sqrt(np.diag(odometry_messages.pose_covariance(message, axes)))
    way_m = 0.1 * last.stamp.t_ns * 1e-9
    assert sigma[0] == pytest.approx(math.hypot(0.001, 0.01 * math.sqrt(way_m)), rel=0.02)
    np.testing.assert_allclose(sigma[3:], 0.002, rtol=1e-6)
    triangle = np.zeros((6, 6))
    triangle[np.triu_indices(6)] = message.velocity_covariance
    np.testing.assert_allclose(np.sqrt(np.diag(triangle)), [0.003] * 3 + [0.004] * 3, rtol=1e-5)


def test_default_errors_are_those_of_a_camera_and_the_same_seed_gives_the_same_poses(
    mavlink_bench, travelling_plant
):
    def run(seed):
        plant = travelling_plant(twist=(0.1, 0.0, 0.0), start=(0, 0, 0))
        bench = mavlink_bench(plant=plant, options=ComputerTruthOptions(), seed=seed)
        bench.driver.open()
        return plant, [m for m in aligned(bench, follow(bench, 8.0)) if m.valid]

    ratios = []
    for seed in range(5):
        plant, measured = run(seed)
        moved = between(plant.pose(measured[0].stamp.t_ns), plant.pose(measured[-1].stamp.t_ns))
        ratios.append(measured[-1].pose[0] / moved[0] - 1.0)
    assert 0.001 < np.std(ratios) < 0.02
    again = run(4)[1]
    assert [m.stamp for m in measured] == [m.stamp for m in again]
    assert all((a.pose == b.pose).all() for a, b in zip(measured, again, strict=True))


def test_a_young_map_has_failed_or_low_quality_until_it_is_good(mavlink_bench):
    options = dataclasses.replace(IDEAL, settle_s=(2.0, 0.5, 0.5))
    bench = mavlink_bench(options=options)
    bench.driver.open()
    samples = follow(bench, 4.0)
    order = list(dict.fromkeys((s.status, s.confidence) for s in samples))
    assert order == [(Status.NOT_TRACKED, 0), (Status.LOW_CONFIDENCE, 1), (Status.OK, 2), (Status.OK, 3)]
    assert all(np.isnan(s.position_m).all() for s in samples if s.status is Status.NOT_TRACKED)
