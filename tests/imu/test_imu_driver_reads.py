"""The driver on the emulated chip: what it reports is the truth of the world, within the sensor's errors."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hil.core.geometry import quat_conjugate, quat_rotate, yaw_of_quat
from hil.core.signals import Status
from hil.fakes.imu.bno055.sensor_physics import ImuTruthOptions

IDEAL = ImuTruthOptions(
    gyro_noise_rad_s=0,
    gyro_bias_rad_s=0,
    accelerometer_noise_m_s2=0,
    accelerometer_offset_m_s2=0,
    magnetometer_noise_ut=0,
    magnetometer_offset_ut=0,
    yaw_drift_rad_s=0,
)


def settle(bench, cycles, period_ns=10_000_000):
    samples = []
    t_ns = bench.clock.now_ns()
    for _ in range(cycles):
        samples += bench.driver.read()
        t_ns += period_ns
        bench.clock.sleep_until_ns(t_ns)
    return samples


@pytest.mark.parametrize("theta_rad", [-3.0, -1.0, 0.0, 0.7, 2.5])
def test_on_a_vertical_wall_gravity_gives_the_heading(imu_bench, turning_plant, theta_rad):
    bench = imu_bench(plant=turning_plant(theta_rad=theta_rad), options=IDEAL)
    bench.driver.open()
    sample = settle(bench, 5)[-1]
    assert sample.status is Status.OK
    assert math.atan2(-sample.gravity_m_s2[1], sample.gravity_m_s2[0]) == pytest.approx(theta_rad, abs=2e-3)
    assert sample.gravity_m_s2[2] == pytest.approx(0.0, abs=0.006)


@pytest.mark.parametrize("tilt_rad", [0.0, 0.6, math.pi / 2, 2.5])
def test_quaternion_and_gravity_agree_at_any_tilt(imu_bench, turning_plant, tilt_rad):
    mount = (0.5, 0.5, -0.5, 0.5)
    bench = imu_bench(
        plant=turning_plant(tilt_rad=tilt_rad, theta_rad=0.4), config={"mount_rotation_wxyz": mount}
    )
    bench.driver.open()
    sample = settle(bench, 5)[-1]
    up = quat_rotate(quat_conjugate(sample.quaternion_wxyz), [0.0, 0.0, 9.80665])
    np.testing.assert_allclose(up, sample.gravity_m_s2, atol=0.01)


@pytest.mark.parametrize(("axis_map", "axis_sign"), [(0x24, 0), (0x21, 4), (0x24, 6), (0x21, 7), (0x24, 5)])
def test_the_configured_remap_makes_the_mount_true(imu_bench, turning_plant, axis_map, axis_sign):
    bench = imu_bench(
        plant=turning_plant(theta_rad=0.3, rate_rad_s=0.0),
        options=IDEAL,
        config={"axis_map": axis_map, "axis_sign": axis_sign},
    )
    bench.driver.open()
    gravity = settle(bench, 5)[-1].gravity_m_s2
    np.testing.assert_allclose(gravity, 9.80665 * np.array([math.cos(0.3), -math.sin(0.3), 0.0]), atol=0.01)


@pytest.mark.parametrize(
    ("fusion_mode", "relative"),
    [("imu", True), ("m4g", True), ("compass", False), ("ndof_fmc_off", False), ("ndof", False)],
)
def test_the_heading_is_relative_to_the_start_or_to_north(imu_bench, turning_plant, fusion_mode, relative):
    """Which modes give which: Bosch BNO055 datasheet rev 1.4, 3.3.3."""
    facing_rad, turned_rad = 0.7, 0.5
    bench = imu_bench(
        "imu:reset@3",
        plant=turning_plant(tilt_rad=0.0, theta_rad=facing_rad),
        options=replace(IDEAL, gyro_noise_rad_s=2e-3, accelerometer_noise_m_s2=0.02),
        config={"fusion_mode": fusion_mode},
    )

    def heading_rad(cycles):
        sample = settle(bench, cycles)[-1]
        assert sample.status is Status.OK
        return yaw_of_quat(sample.quaternion_wxyz)

    bench.driver.open()
    assert heading_rad(20) == pytest.approx(0.0 if relative else facing_rad, abs=1e-3)
    bench.plant.theta_rad += turned_rad
    assert heading_rad(20) == pytest.approx(turned_rad if relative else facing_rad + turned_rad, abs=1e-3)
    assert heading_rad(500) == pytest.approx(0.0 if relative else facing_rad + turned_rad, abs=1e-3)


def test_the_gyro_reads_the_rate_about_the_wall_normal(imu_bench, turning_plant):
    bench = imu_bench(plant=turning_plant(rate_rad_s=0.25), options=IDEAL)
    bench.driver.open()
    assert settle(bench, 5)[-1].gyro_rad_s[2] == pytest.approx(0.25, abs=0.001)


def test_off_the_centre_of_rotation_the_accelerometer_feels_the_turn(imu_bench, turning_plant):
    """w^2 r towards the centre, from rigid-body kinematics."""
    bench = imu_bench(plant=turning_plant(tilt_rad=0.0, rate_rad_s=2.0), options=IDEAL)
    bench.driver.open()
    sample = settle(bench, 4)[-1]
    assert sample.linear_acceleration_m_s2[0] == pytest.approx(-4.0 * 0.0655, abs=0.03)


def test_calibration_improves_at_rest_and_with_motion(imu_bench, turning_plant):
    bench = imu_bench(plant=turning_plant(), options=ImuTruthOptions(gyro_bias_rad_s=0.02))
    bench.driver.open()
    first, *_, rested = (s for s in settle(bench, 250) if s.status is Status.OK)
    assert first.calibration[1] == 0
    assert rested.calibration[1] == 3
    assert rested.calibration[2] == 0
    assert np.max(np.abs(rested.gyro_rad_s)) < 0.01
    bench.plant.rate_rad_s = 1.0
    assert settle(bench, 700)[-1].calibration[2] == 3


@pytest.mark.parametrize("prefetch", [False, True])
def test_the_stamp_is_when_the_data_were_true(imu_bench, turning_plant, prefetch):
    """The heading from gravity against the true heading at the time of the stamp, while turning."""
    bench = imu_bench(
        plant=turning_plant(rate_rad_s=1.0),
        options=IDEAL,
        config={"prefetch": prefetch},
        overrun_probability=0.05,
    )
    bench.driver.open()
    late_s = []
    for sample in settle(bench, 400):
        if sample.status is Status.OK:
            seen = math.atan2(-sample.gravity_m_s2[1], sample.gravity_m_s2[0])
            late_s.append(math.remainder(sample.stamp.t_ns * 1e-9 - seen, 2 * math.pi))
    assert len(late_s) > 350
    assert abs(np.mean(late_s)) < 0.006
    assert np.ptp(late_s) < 0.02


def test_prefetching_takes_the_wire_out_of_the_read(imu_bench):
    """Also where mode and system status are looked at every tenth time."""
    spent = {}
    for prefetch in (False, True):
        bench = imu_bench(config={"prefetch": prefetch, "check_period_s": 0.1}, overrun_probability=0.0)
        bench.driver.open()
        settle(bench, 5)
        spent[prefetch] = []
        for _ in range(50):
            before_ns = bench.clock.now_ns()
            assert bench.driver.read()[0].status is Status.OK
            spent[prefetch].append(bench.clock.now_ns() - before_ns)
            bench.clock.sleep_until_ns(before_ns + 10_000_000)
    assert min(spent[False]) > 3_400_000
    assert max(spent[True]) < 400_000


def test_prefetching_survives_everything_that_interrupts_it(imu_bench):
    bench = imu_bench(
        "imu:reset@1",
        "imu:off@3+0.3",
        "imu:garbage@5+0.2",
        config={"prefetch": True},
        overrun_probability=0.05,
    )
    bench.driver.open()
    samples = settle(bench, 700)
    kinds = [s.status for s in samples]
    assert kinds.count(Status.RESET) == 2
    assert kinds.count(Status.OK) > 400
    assert kinds[-20:].count(Status.OK) >= 18
    bench.driver.read_calibration()
    assert Status.OK in [s.status for s in settle(bench, 5)]
