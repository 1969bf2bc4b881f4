"""Every fault of servos and line ends as data with a status, a repair, or a named device error."""

import numpy as np
import pytest
from servo_client import Client
from servo_cycles import CYCLE_NS, ROLLING, SECOND, STILL, between, cycles, statuses
from servo_wire import Wire

from hil.core.errors import DeviceError, DeviceTimeoutError, FaultNotSupportedError
from hil.core.signals import Status
from hil.faults.fault import parse_fault
from tests.selected import every


@pytest.mark.parametrize("fault", ["servos:bus_off", "servo.drive_FL:unplug", "servo.9:off"])
def test_others_are_refused(servo_bench, fault):
    with pytest.raises(FaultNotSupportedError):
        servo_bench(fault, open_driver=False)


@pytest.mark.parametrize(
    ("fast", "behaviour", "joint"),
    every(7, [(f, b, j) for f in ("auto", False) for b in ("silent", "skip") for j in range(8)]),
)
def test_a_dead_servo_costs_little_and_affects_no_other_servo(servo_bench, joint, behaviour, fast):
    bench = servo_bench(after_absent=behaviour, config={"fail_after_s": 60.0, "fast_sync_read": fast})
    bench.driver.enable()

    def durations(count):
        found = []
        for _ in range(count):
            began = bench.clock.now_ns()
            bench.driver.read()
            found.append(bench.clock.now_ns() - began)
            bench.clock.sleep_until_ns(began + CYCLE_NS)
        return found

    healthy = durations(40)
    bench.world.faults.add(parse_fault(f"servo.{joint + 1}:off"))
    dead = durations(200)
    assert max(dead) - max(healthy) <= 3_000_000
    assert np.mean(dead) - np.mean(healthy) < 100_000
    last = bench.driver.read()[0]
    assert last.status[joint] is Status.TIMEOUT
    assert all(last.status[j] is Status.OK for j in range(8) if j != joint)
    assert np.isnan([last.position_rad[joint], last.velocity_rad_s[joint], last.current_a[joint]]).all()


def test_a_dead_servo_is_an_error_once_it_lasts(servo_bench):
    bench = servo_bench("servo.steer_BL:off@1")
    bench.driver.enable()
    with pytest.raises(
        DeviceTimeoutError, match=r"nothing usable for 2 s from steer_BL \(ID 6\): timeout"
    ) as caught:
        cycles(bench, 5)
    assert "check cable" in caught.value.remedy
    assert bench.clock.now_ns() == pytest.approx(3.0 * SECOND, rel=0.02)


def test_servos_that_die_one_by_one_until_none_is_left_and_come_back(servo_bench):
    faults = [f"servo.{i}:off@{0.5 + 0.1 * i}+{2.5 - 0.1 * i}" for i in range(1, 9)]
    bench = servo_bench(*faults, config={"fail_after_s": 60.0, "health_period_s": 0.3})
    bench.driver.enable()
    samples = cycles(bench, 2.5)
    assert set(samples[-1].status) == {Status.TIMEOUT}
    assert bench.driver.read_health() == ()
    back = cycles(bench, 5)
    assert back[-1].ok
    assert all(s.torque for s in bench.bus.servos)


def test_a_servo_that_restarts_without_torque_is_left_without(servo_bench):
    bench = servo_bench("servo.4:brownout@0.5+0.5")
    samples = cycles(bench, 3)
    assert Status.RESET in statuses(samples, 3)
    assert samples[-1].ok
    assert not any(s.torque for s in bench.bus.servos)


@pytest.mark.parametrize("fault", ["servo.3:reset@0.5", "servo.3:off@0.5+0.4"])
def test_a_restarted_servo_is_set_up_again_and_counts_on(servo_bench, fault):
    bench = servo_bench(fault, config={"health_period_s": 0.2})
    bench.driver.enable()
    samples = cycles(bench, 2.5, ROLLING)
    assert {Status.OK, Status.TIMEOUT, Status.RESET} >= statuses(samples, 2)
    assert Status.RESET in statuses(samples, 2)
    assert {s.status[2] for s in samples[-50:]} == {Status.OK}
    assert bench.bus.servos[2].torque
    assert samples[-1].velocity_rad_s[2] == pytest.approx(2.0, abs=0.05)
    offset = samples[5].position_rad[2]
    moved = samples[-1].position_rad[2] - offset
    true = bench.plant.position[2]
    assert moved == pytest.approx(true, abs=0.15)
    assert statuses(samples, 1) == {Status.OK}


def test_stuck_wrong_delayed_and_slow(servo_bench):
    bench = servo_bench(
        "servo.1:stuck@1+0.5",
        "servo.5:wrong@1+0.5,angle_rad=0.3",
        "servo.3:delayed@2+1,delay_s=0.2",
        "servo.4:slow@1+0.5,answer_s=0.0005",
    )
    bench.driver.enable()
    samples = cycles(bench, 3, ROLLING)
    frozen = between(samples, 1.05, 1.45)
    assert len({s.position_rad[0] for s in frozen}) == 1
    wrong = between(samples, 1.1, 1.4)
    assert np.mean([s.position_rad[4] for s in wrong]) == pytest.approx(0.2 + 0.3, abs=0.01)
    assert np.mean([s.position_rad[4] for s in between(samples, 1.6, 1.9)]) == pytest.approx(0.2, abs=0.01)
    before, during = between(samples, 1.8, 1.95)[-1], between(samples, 2.5, 2.9)[0]
    dt_s = (during.stamp.t_ns - before.stamp.t_ns) * 1e-9
    assert during.position_rad[2] - before.position_rad[2] == pytest.approx(2.0 * (dt_s - 0.2), abs=0.05)
    slow = between(samples, 1.05, 1.45)
    assert statuses(slow, 3) == {Status.OK}


def test_a_slipped_magnet_is_reported_and_bridged(servo_bench):
    bench = servo_bench("servo.2:jump@1,angle_rad=2.5")
    bench.driver.enable()
    samples = cycles(bench, 2)
    reported = [s for s in samples if s.status[1] is not Status.OK]
    assert [s.status[1] for s in reported] == [Status.RESET]
    assert statuses(samples, 0) == {Status.OK}


@pytest.mark.parametrize(
    ("fault", "fast"),
    [
        ("servo.1:garbage@1+0.3", "auto"),
        ("servo.8:garbage@1+0.3", False),
        ("servos:garbage@1+0.3", "auto"),
        ("servos:garbage@1+0.3", False),
    ],
)
def test_garbage_is_never_a_number(servo_bench, fault, fast):
    bench = servo_bench(fault, config={"fast_sync_read": fast})
    bench.driver.enable()
    still = bench.driver.read()[0].position_rad
    samples = cycles(bench, 1.8)
    bad = between(samples, 1.01, 1.29)
    joint = 0 if "servo.1" in fault else 7
    assert Status.OK not in statuses(bad, joint)
    for s in samples:
        good = [j for j in range(8) if s.status[j] is Status.OK]
        np.testing.assert_allclose(s.position_rad[good], still[good], atol=0.01)
    assert samples[-1].ok
    if fast is False and "servos" not in fault:
        assert statuses(samples, 3) == {Status.OK}


@pytest.mark.parametrize(
    ("fault", "fast"),
    every(
        2,
        [
            ("servos:drop@1,probability=0.03", "auto"),
            ("servos:corrupt@1,probability=0.03", False),
            ("servos:truncate@1,probability=0.03", "auto"),
            ("servos:duplicate@1,probability=0.2", False),
            ("servo.4:drop@1,probability=0.1", "auto"),
            ("servo.4:corrupt@1,probability=0.1", False),
            ("servo.5:intermittent@1,period_s=0.2,duty=0.3", "auto"),
        ],
    ),
)
def test_a_bad_line_costs_readings_but_never_truth(servo_bench, fault, fast):
    bench = servo_bench(fault, config={"fast_sync_read": fast}, seed=7)
    bench.driver.enable()
    start = bench.driver.read()[0].position_rad - bench.plant.position
    samples = cycles(bench, 4, ROLLING)
    good = bad = 0
    for s in samples:
        for j in range(8):
            usable = s.status[j] in (Status.OK,)
            good, bad = good + usable, bad + (not usable)
            assert np.isfinite(s.position_rad[j]) == usable
    assert good > 0.8 * (good + bad)
    assert bad > 0 or "duplicate" in fault
    last = next(s for s in reversed(samples) if s.ok)
    age_s = (bench.clock.now_ns() - last.stamp.t_ns) * 1e-9
    true = bench.plant.position + start - age_s * bench.plant.velocity
    np.testing.assert_allclose(last.position_rad, true, atol=0.02)


@pytest.mark.parametrize(("fast", "behaviour"), [("auto", "silent"), (False, "silent"), (False, "skip")])
def test_a_servo_that_answers_every_other_read_costs_no_other_servo(servo_bench, fast, behaviour):
    """Drive_FL leads the reply, so that a silence of it loses the whole reply once, and not again."""
    fault = "servo.drive_FL:intermittent@0.5,period_s=0.02,duty=0.5"
    bench = servo_bench(fault, config={"fast_sync_read": fast}, after_absent=behaviour)
    bench.driver.enable()
    samples = between(cycles(bench, 2.5), 0.5, 2.5)
    lost = [sum(s.status[j] is not Status.OK for s in samples) for j in range(8)]
    assert lost[0] == pytest.approx(len(samples) / 2, rel=0.1)
    assert max(lost[1:]) <= 1


@pytest.mark.parametrize("kind", ["drop", "truncate"])
def test_a_probability_is_that_of_a_whole_reply(servo_bench, kind):
    """Of one packet by all servos, or of eight: a fifth of the reads, as the page on faults says."""
    for fast in ("auto", False):
        bench = servo_bench(
            f"servos:{kind}@1,probability=0.2", config={"fast_sync_read": fast, "fail_after_s": 60.0}
        )
        bench.driver.enable()
        hit = [not s.ok for s in between(cycles(bench, 6.1), 1.0, 6.1)]
        assert len(hit) > 490
        assert np.mean(hit) == pytest.approx(0.2, abs=0.05), fast
        bench.line.close()


def test_replies_in_pieces_are_put_together(servo_bench):
    bench = servo_bench("servos:pieces@1,size=16,gap_s=0.0001")
    bench.driver.enable()
    assert np.mean([s.ok for s in cycles(bench, 4)]) > 0.99


def test_a_pulled_adapter_and_its_return(servo_bench):
    bench = servo_bench("servos:unplug@1+0.5", "servos:unplug@3")
    bench.driver.enable()
    samples = cycles(bench, 2.5)
    gone = between(samples, 1.05, 1.45)
    assert 30 < len(gone) <= 45
    assert {s for sample in gone for s in sample.status} == {Status.TIMEOUT}
    assert samples[-1].ok
    with pytest.raises(DeviceTimeoutError, match="nothing usable"):
        cycles(bench, 9)
    bench.driver.stop()
    bench.driver.command(STILL)
    with pytest.raises(DeviceError, match="no servo answers"):
        bench.driver.release()
    bench.driver.close()


@pytest.mark.parametrize("fault", ["off@0.004", "off@0.028", "unplug@0.01"])
def test_a_bus_that_goes_while_setting_up_is_a_device_error(servo_bench, fault):
    with pytest.raises(DeviceError):
        servo_bench(f"servos:{fault}")


def test_overload_is_reported_and_becomes_an_error_and_enabling_is_refused(servo_bench):
    bench = servo_bench()
    bench.driver.enable()
    bench.plant.load_a[4] = 1.3
    samples = cycles(bench, 3)
    with pytest.raises(DeviceError, match=r"steer_FL \(ID 5\): hardware error overload") as caught:
        samples += cycles(bench, 7)
    assert "reboot the servo" in caught.value.remedy
    with pytest.raises(DeviceError, match="hardware error overload"):
        bench.driver.enable()
    bench.driver.close()
    bench.driver.open()
    with pytest.raises(DeviceError, match=r"hardware errors: steer_FL \(overload\)"):
        bench.driver.enable()


def test_an_alert_carries_the_error_bits_beside_the_sample(servo_bench):
    bench = servo_bench()
    bench.driver.enable()
    bench.plant.load_a[2] = 1.3
    samples = cycles(bench, 3.5)
    flagged = [s for s in samples if s.status[2] is Status.HARDWARE_ERROR]
    assert {s.alert[2] for s in flagged} == {0x20}
    assert all(np.isnan(s.position_rad[2]) for s in flagged)
    bench.plant.load_a[2] = 0.0
    Client(Wire(bench.world, bench.bus), 3).do(8, wait_ms=200)
    after = cycles(bench, 6)
    assert after[-1].status[2] is Status.OK
    assert after[-1].alert == (0,) * 8


def test_a_bus_that_falls_silent_altogether(servo_bench):
    bench = servo_bench("servos:off@1")
    bench.driver.enable()
    cycles(bench, 1)
    began = bench.clock.now_ns()
    (sample,) = bench.driver.read()
    assert bench.clock.now_ns() - began < 9_000_000
    assert set(sample.status) == {Status.TIMEOUT}
    with pytest.raises(DeviceTimeoutError, match=r"drive_FL(.*)steer_FR"):
        cycles(bench, 6)


@pytest.mark.parametrize(
    ("fast", "share"), [(False, 0.2 / 8), ("auto", np.mean([0.2 * (8 + 14 * k) / 120 for k in range(1, 9)]))]
)
def test_a_damaged_bit_costs_the_values_that_its_checksum_covers(servo_bench, fast, share):
    """A plain reply is eight packets. A fast one is 120 bytes, with a checksum every 14 over all before."""
    config = {"fast_sync_read": fast, "retry_budget_s": 0.0}
    bench = servo_bench("servos:corrupt@1,probability=0.2", config=config)
    bench.driver.enable()
    found = between(cycles(bench, 16, ROLLING), 1, 16)
    lost = np.mean([[one is not Status.OK for one in sample.status] for sample in found])
    assert lost == pytest.approx(share, rel=0.1)


def test_values_that_are_asked_ahead_are_asked_again_when_damaged(servo_bench):
    bench = servo_bench("servos:corrupt@1,probability=0.2", config={"prefetch": True})
    bench.driver.enable()
    found = between(cycles(bench, 9, ROLLING), 1, 9)
    assert np.mean([[one is not Status.OK for one in sample.status] for sample in found]) < 0.02
