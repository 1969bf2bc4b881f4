"""The driver on the emulated sensor: it reports the truth of the world, within the sensor's errors."""

import dataclasses
import math

import numpy as np
import pytest

from hil.core.errors import DeviceError
from hil.core.geometry import quat_conjugate, quat_rotate
from hil.core.signals import Stamp, Status
from hil.drivers.imu.microstrain import filter_samples
from hil.links.mip import fields as f
from hil.links.mip.packets import Field, Packet

LABEL_UP = (0.0, 1.0, 0.0, 0.0)


def in_body(sample, mount=LABEL_UP):
    return quat_rotate(mount, sample.gravity_m_s2)


@pytest.mark.parametrize("theta_rad", [-3.0, -1.0, 0.0, 0.7, 2.5])
def test_on_a_vertical_wall_gravity_gives_the_heading(bench, turning_plant, ideal, theta_rad):
    b = bench(plant=turning_plant(theta_rad=theta_rad), options=ideal)
    b.driver.open()
    sample = b.run(0.1)[-1]
    assert sample.status is Status.OK
    up = in_body(sample)
    assert math.atan2(-up[1], up[0]) == pytest.approx(theta_rad, abs=1e-6)
    assert up[2] == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("tilt_rad", [0.0, 0.6, math.pi / 2, 2.5])
@pytest.mark.parametrize("mount", [LABEL_UP, (0.5, 0.5, -0.5, 0.5)])
def test_quaternion_and_gravity_agree_at_any_tilt(bench, turning_plant, tilt_rad, mount):
    b = bench(plant=turning_plant(tilt_rad=tilt_rad, theta_rad=0.4), config={"mount_rotation_wxyz": mount})
    b.driver.open()
    sample = b.run(0.1)[-1]
    up = quat_rotate(quat_conjugate(sample.quaternion_wxyz), [0.0, 0.0, 1.0])
    np.testing.assert_allclose(9.780325 * up, sample.gravity_m_s2, atol=1e-4)


@pytest.mark.parametrize("magnetometer", [False, True])
def test_the_quaternion_turns_as_the_robot_does(bench, turning_plant, ideal, magnetometer):
    """A turn to the left is positive about up; without magnetometer it is from the start of the filter.

    Source: 3DM-CV7 user manual, "Filter Initialization".
    """
    facing_rad, turned_rad = 0.7, 0.5
    b = bench(
        "imu:reset@3",
        plant=turning_plant(tilt_rad=0.0, theta_rad=facing_rad),
        options=dataclasses.replace(ideal, gyro_noise_rad_s=1e-4),
        config={"magnetometer": magnetometer},
    )

    def heading_rad(duration_s):
        """Of the robot about up: the driver gives attitude in axes that have z up."""
        sample = b.run(duration_s)[-1]
        assert sample.status is Status.OK
        forward = quat_rotate(sample.quaternion_wxyz, [1.0, 0.0, 0.0])
        return math.atan2(forward[1], forward[0])

    b.driver.open()
    start_rad = facing_rad if magnetometer else 0.0
    assert heading_rad(0.1) == pytest.approx(start_rad, abs=1e-6)
    b.plant.theta_rad += turned_rad
    assert heading_rad(0.1) == pytest.approx(start_rad + turned_rad, abs=1e-6)
    again_rad = facing_rad + turned_rad if magnetometer else 0.0
    assert heading_rad(9.0) == pytest.approx(again_rad, abs=1e-6)


def test_the_gyro_reads_the_rate_about_the_wall_normal(bench, turning_plant, ideal):
    b = bench(plant=turning_plant(rate_rad_s=0.25), options=ideal)
    b.driver.open()
    rate = quat_rotate(LABEL_UP, b.run(0.1)[-1].gyro_rad_s)
    np.testing.assert_allclose(rate, [0.0, 0.0, 0.25], atol=1e-6)


def test_off_the_centre_of_rotation_the_accelerometer_feels_the_turn(bench, turning_plant, ideal):
    """w^2 r towards the centre, from rigid-body kinematics."""
    b = bench(plant=turning_plant(tilt_rad=0.0, rate_rad_s=2.0), options=ideal)
    b.driver.open()
    sample = b.run(0.1)[-1]
    force = quat_rotate(LABEL_UP, sample.linear_acceleration_m_s2)
    assert force[0] == pytest.approx(-4.0 * 0.0655, abs=0.01)


def test_linear_acceleration_and_gravity_add_up_to_the_specific_force(bench, turning_plant):
    """As a 3DM-CV7-AHRS at rest shows it: what its filter takes for gravity is a little short, and the
    rest shows as acceleration."""
    b = bench(plant=turning_plant(tilt_rad=0.0))
    b.driver.open()
    samples = b.run(2.0)
    force = np.mean([s.gravity_m_s2 + s.linear_acceleration_m_s2 for s in samples], axis=0)
    offset = b.chip.sensing.accelerometer_offset
    np.testing.assert_allclose(force, np.add([0.0, 0.0, -9.80665], offset), atol=0.006)
    assert np.linalg.norm(samples[-1].gravity_m_s2) == pytest.approx(9.780, abs=1e-3)


def test_a_real_sensors_figures_at_rest_are_read_with_the_right_signs():
    """A 3DM-CV7-AHRS flat, label up: accelerometer (-0.060, 0.046, -9.820) m/s^2 as logged in public."""
    values = {
        f.REFERENCE_TIME: (1,),
        f.STATUS: (3, 1, 1),
        f.QUATERNION: (0.999247, -0.002082, -0.002717, 0.038652, 1),
        f.ANGULAR_RATE: (-0.0011, 0.0024, 0.0009, 1),
        f.LINEAR_ACCELERATION: (-0.0083, 0.0037, -0.0403, 1),
        f.GRAVITY: (0.0515, -0.0427, 9.7799, 1),
    }
    packet = Packet(f.FILTER_DATA, tuple(Field(k, f.LAYOUTS[k].pack(*v)) for k, v in values.items()))
    data = f.FilterData.of(packet)
    assert filter_samples.judge(data) is Status.OK
    sample = filter_samples.sample(data, Stamp(0, 0, 1), Status.OK)
    felt = sample.gravity_m_s2 + sample.linear_acceleration_m_s2
    np.testing.assert_allclose(felt, [-0.060, 0.046, -9.820], atol=1e-3)
    up = quat_rotate(quat_conjugate(sample.quaternion_wxyz), [0.0, 0.0, 9.78])
    np.testing.assert_allclose(sample.gravity_m_s2, up, atol=0.002)


@pytest.mark.parametrize(("base_rate_hz", "rate_hz"), [(1000, 1000 / 9), (500, 100.0)])
def test_samples_come_at_the_rate_that_the_sensor_can(bench, ideal, base_rate_hz, rate_hz):
    b = bench(options=dataclasses.replace(ideal, base_rate_hz=base_rate_hz))
    b.driver.open()
    samples = b.run(2.0)
    assert len(samples) == pytest.approx(2.0 * rate_hz, abs=2)
    assert b.driver.rate_hz == pytest.approx(rate_hz)
    assert np.diff([s.stamp.device_ns for s in samples]).tolist() == pytest.approx(
        [1e9 / rate_hz] * (len(samples) - 1), abs=2
    )


@pytest.mark.parametrize("baud", [115_200, 921_600])
def test_the_stamp_is_when_the_data_were_true(bench, turning_plant, ideal, baud):
    """The heading from gravity against the true heading at the time of the stamp, while turning.

    Late by no more than the adapter's 1 ms and the 1 ms by which the sensor's samples step through the cycle.
    """
    centred = dataclasses.replace(ideal, position_m=(0.0, 0.0, 0.0))
    b = bench(plant=turning_plant(rate_rad_s=1.0), options=centred, config={"baud": baud}, baud=baud)
    b.driver.open()
    late_s = []
    for sample in b.run(4.0)[20:]:
        up = in_body(sample)
        seen = math.atan2(-up[1], up[0])
        late_s.append(math.remainder(sample.stamp.t_ns * 1e-9 - seen, 2 * math.pi))
    assert len(late_s) > 400
    assert min(late_s) > -0.0005
    assert max(late_s) < 0.0025


def test_stamps_follow_a_clock_that_runs_wrong(bench, turning_plant, ideal):
    options = dataclasses.replace(ideal, position_m=(0.0, 0.0, 0.0), clock_ppm=-80.0)
    b = bench(plant=turning_plant(rate_rad_s=0.5), options=options)
    b.driver.open()
    for _ in range(4):
        b.run(12.5)
        sample = b.run(0.05)[-1]
        up = in_body(sample)
        late = math.remainder(0.5 * sample.stamp.t_ns * 1e-9 - math.atan2(-up[1], up[0]), 2 * math.pi) / 0.5
        assert -0.0005 < late < 0.003


def test_a_thousand_samples_per_second_on_a_fast_line(bench):
    b = bench(config={"baud": 921_600, "rate_hz": 900.0}, baud=921_600)
    with pytest.raises(DeviceError, match="cannot measure at 900 Hz"):
        b.driver.open()
    b = bench(config={"baud": 921_600, "rate_hz": 500.0}, baud=921_600)
    b.driver.open()
    samples = b.run(1.0)
    assert len(samples) == pytest.approx(500, abs=5)
    assert {s.status for s in samples} == {Status.OK}
    assert set(np.diff([s.stamp.seq for s in samples])) == {1}
