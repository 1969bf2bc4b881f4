"""Torque on and off, stop, release and close: the wheels rest and the robot is held, whatever was asked."""

import numpy as np
import pytest
from servo_cycles import ROLLING, SECOND, STILL, cycles

from hil.core.errors import DeviceError, DeviceTimeoutError, UsageError
from hil.core.signals import ServoSetpoint
from hil.faults.fault import parse_fault


def test_servos_that_fall_silent_for_good_while_torque_comes_on_are_reported(servo_bench):
    reference = servo_bench()
    began = reference.clock.now_ns()
    reference.driver.read()
    read_ns = reference.clock.now_ns() - began
    reference.line.close()
    at_s = (began + read_ns + 200_000) * 1e-9
    bench = servo_bench(f"servos:drop@{at_s:.7f},probability=1")
    with pytest.raises(DeviceError, match="cannot be enabled: drive_FL timeout") as caught:
        bench.driver.enable()
    assert "power" in caught.value.remedy
    assert bench.clock.now_ns() * 1e-9 - at_s < 2.0


def test_enabling_needs_all_eight(servo_bench):
    bench = servo_bench("servo.6:off@1")
    bench.clock.sleep_until_ns(SECOND)
    with pytest.raises(DeviceTimeoutError, match="cannot be enabled: steer_BL timeout"):
        bench.driver.enable()
    hold = bench.driver.look_after()
    assert set(hold.trouble) == {"steer_BL"}
    assert [s.torque for s in bench.bus.servos] == [j != 5 for j in range(8)]


def test_torque_that_does_not_go_off_is_reported(servo_bench):
    bench = servo_bench()
    said = set()
    for _ in range(40):
        bench.driver.enable()
        bench.world.faults.add(parse_fault("servos:corrupt,probability=0.6,direction=both"))
        try:
            bench.driver.release()
        except DeviceError as error:
            said.add(error.message)
        bench.world.faults.clear()
    assert any("torque is not off: drive_FL, drive_BL" in text for text in said)
    assert any(" (no answer)" in text for text in said)
    assert any("torque is not off: no servo answers" in text for text in said)


def test_release_lets_go_and_stop_holds(servo_bench):
    bench = servo_bench()
    bench.driver.enable()
    cycles(bench, 1, ROLLING)
    bench.driver.stop()
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 400_000_000)
    np.testing.assert_allclose(bench.plant.velocity, 0.0, atol=0.01)
    np.testing.assert_allclose(bench.plant.position[4:], ROLLING.steer_position_rad, atol=0.01)
    assert all(s.torque for s in bench.bus.servos)
    bench.driver.release()
    assert not any(s.torque for s in bench.bus.servos)
    assert {c.mode for c in bench.plant.commands} == {"off"}


def test_closing_rests_the_wheels_and_keeps_the_robot_held(servo_bench):
    bench = servo_bench()
    bench.driver.enable()
    cycles(bench, 1, ROLLING)
    bench.driver.close()
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 500_000_000)
    np.testing.assert_allclose(bench.plant.velocity, 0.0, atol=0.01)
    assert all(s.torque for s in bench.bus.servos)


def test_goals_are_clipped_to_bench_and_servo(servo_bench):
    bench = servo_bench(
        eeprom={0: {"velocity_limit": 100}, 4: {"max_position_limit": 2500}}, config={"steer_limit_rad": 1.0}
    )
    bench.driver.enable()
    last = cycles(bench, 1, ServoSetpoint(np.array([9.0, 9.0, -9.0, 4.0]), np.array([2.0, 2.0, -2.0, 0.5])))[
        -1
    ]
    np.testing.assert_allclose(last.velocity_rad_s[:4], [2.397, 4.89, -4.89, 4.0], atol=0.05)
    np.testing.assert_allclose(last.position_rad[4:], [0.693, 1.0, -1.0, 0.5], atol=0.01)


def test_goals_that_are_clipped_are_counted_at_once_and_by_servo(servo_bench):
    bench = servo_bench(eeprom={0: {"velocity_limit": 100}, 4: {"max_position_limit": 2500}})
    bench.driver.enable()
    at_the_limits = ServoSetpoint(np.array([2.39, 4.9, -4.9, 0.0]), np.array([0.69, 2.618, -2.618, 0.0]))
    health = []
    for setpoint, many in ((at_the_limits, 5), (ServoSetpoint(np.full(4, 3.0), np.full(4, 0.8)), 20)):
        for _ in range(many):
            bench.driver.read()
            health += bench.driver.read_health()
            bench.driver.command(setpoint)
            bench.clock.sleep_until_ns(bench.clock.now_ns() + 10_000_000)
    first, *_ = (one for one in health if any(one.clipped))
    assert [n > 0 for n in first.clipped] == [True, False, False, False, True, False, False, False]
    assert bench.clock.now_ns() - first.stamp.t_ns > 150_000_000  # it did not wait for the next second


def test_a_killed_program_leaves_a_held_robot(servo_bench):
    bench = servo_bench()
    bench.driver.enable()
    cycles(bench, 1, ROLLING)
    assert bench.plant.velocity[0] > 0.9
    bench.world.advance_to(bench.clock.now_ns() + SECOND)
    np.testing.assert_allclose(bench.plant.velocity, 0.0, atol=0.01)
    assert all(s.torque and s.tripped for s in bench.bus.servos)


def test_without_a_watchdog_a_wheel_goes_on(servo_bench):
    bench = servo_bench(config={"watchdog_s": 0.0})
    bench.driver.enable()
    cycles(bench, 1, ROLLING)
    bench.world.advance_to(bench.clock.now_ns() + SECOND)
    assert bench.plant.velocity[0] > 0.9


def test_positions_survive_the_wrap_of_the_register(servo_bench):
    """A drive that has turned for days: the 32-bit register wraps, the position goes on."""
    bench = servo_bench()
    bench.driver.enable()
    near = (2**31 - 2500) * 2 * np.pi / 4096
    bench.plant.position[0] += near
    first = cycles(bench, bench.clock.now_ns() / SECOND + 0.3, STILL)[-1].position_rad[0]
    samples = cycles(bench, bench.clock.now_ns() / SECOND + 2.5, ServoSetpoint(np.full(4, 3.0), np.zeros(4)))
    positions = np.array([s.position_rad[0] for s in samples])
    good = np.isfinite(positions)
    assert good.mean() > 0.95
    assert positions[good][-1] - first == pytest.approx(3.0 * 2.45, abs=0.3)
    assert bench.bus.servos[0].present < -(2**31) + 10_000


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_goals_that_are_no_numbers_are_refused(servo_bench, value):
    bench = servo_bench()
    bench.driver.enable()
    for setpoint in (
        ServoSetpoint(np.full(4, value), np.zeros(4)),
        ServoSetpoint(np.zeros(4), np.full(4, np.nan)),
    ):
        with pytest.raises(UsageError, match="not finite"):
            bench.driver.command(setpoint)
