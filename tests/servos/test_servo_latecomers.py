"""Servos that answer late: found, named, waited for after a stop, and taken back when they are quick again.

One late answer holds up everything that is asked behind it on the bus, so that nobody else is heard.
"""

import logging

import numpy as np
import pytest
from servo_cycles import CYCLE_NS, ROLLING, cycles, statuses

from hil.fakes.faults import parse_fault
from hil.vocabulary.errors import DeviceError
from hil.vocabulary.signals import SERVOS, Status

LONG = {"fail_after_s": 60.0}


def looks(bench, count, pause_ns=20_000_000):
    """As after a stop: the servos are looked after again and again; what is wrong, look by look."""
    found = []
    for _ in range(count):
        found.append(bench.driver.look_after())
        bench.clock.sleep_until_ns(bench.clock.now_ns() + pause_ns)
    return found


def late_ones(caplog):
    """IDs that were said to answer late, in order."""
    said = [r.getMessage() for r in caplog.records if "answers after up to" in r.getMessage()]
    return [int(text.split("(ID ")[1].split(")")[0]) for text in said]


@pytest.mark.parametrize("servo_id", range(1, 9))
@pytest.mark.parametrize("answer_s", [0.02, 0.05])
@pytest.mark.parametrize(
    "config", [{}, {"fast_sync_read": False}, {"prefetch": True}, {"reply_slack_s": 0.006}]
)
def test_a_late_servo_is_named_and_takes_nobody_with_it(servo_bench, caplog, servo_id, answer_s, config):
    bench = servo_bench(f"servo.{servo_id}:slow@1,answer_s={answer_s}", config={**LONG, **config})
    bench.driver.enable()
    samples = cycles(bench, 1.2, ROLLING)
    after = samples[-2:]
    joint = servo_id - 1
    assert {s.status[joint] for s in after} == {Status.LATE}
    assert all(s.status[j] is Status.OK for s in after for j in range(8) if j != joint)
    assert all(np.isnan(s.position_rad[joint]) for s in after)
    assert late_ones(caplog) == [servo_id]
    (text,) = [r.getMessage() for r in caplog.records]
    assert text.startswith(f"servos: {SERVOS[joint]} (ID {servo_id}) answers after up to ")
    assert 1e3 * answer_s <= float(text.split("up to ")[1].split(" ms")[0]) <= 1e3 * answer_s + 20
    assert "check its return delay time" in text


@pytest.mark.parametrize("answer_s", [0.02, 0.05, 0.1])
def test_a_late_answer_after_a_stop_is_an_answer(servo_bench, answer_s):
    bench = servo_bench(f"servo.3:slow@1,answer_s={answer_s}", config=LONG)
    bench.driver.enable()
    cycles(bench, 1.12, ROLLING)
    bench.driver.stop()
    last = looks(bench, 12)[-6:]
    assert all(hold.trouble == {} and hold.wanted for hold in last)
    assert all(np.isfinite(hold.position_rad).all() for hold in last)
    np.testing.assert_allclose(bench.plant.velocity[:4], 0.0, atol=0.01)
    assert not any(s.tripped for s in bench.bus.servos)


def test_what_a_late_servo_has_lost_is_put_right(servo_bench):
    bench = servo_bench("servo.3:slow@1,answer_s=0.03", config=LONG)
    bench.driver.enable()
    cycles(bench, 1.3, ROLLING)
    bench.driver.stop()
    looks(bench, 5)
    bench.world.faults.add(parse_fault("servo.3:reset@1.5"))
    found = looks(bench, 30)
    assert any("torque" in hold.trouble.get("drive_BR", "") for hold in found)
    assert found[-1].trouble == {}
    assert bench.bus.servos[2].torque


@pytest.mark.parametrize("pair", [(3, 8), (1, 2), (5, 6), (1, 8)])
@pytest.mark.parametrize("fast", ["auto", False])
def test_two_late_servos_are_both_named_and_nobody_else(servo_bench, caplog, pair, fast):
    faults = [f"servo.{i}:slow@1,answer_s=0.02" for i in pair]
    bench = servo_bench(*faults, config={**LONG, "fast_sync_read": fast})
    bench.driver.enable()
    samples = cycles(bench, 1.2, ROLLING)
    assert sorted(late_ones(caplog)) == sorted(pair)
    assert [s is Status.OK for s in samples[-1].status] == [j + 1 not in pair for j in range(8)]
    bench.driver.stop()
    assert looks(bench, 8)[-1].trouble == {}


@pytest.mark.parametrize(("late", "dead"), [(3, 5), (5, 3), (1, 2), (8, 1)])
def test_a_late_and_a_dead_servo_are_told_apart(servo_bench, caplog, late, dead):
    faults = (f"servo.{late}:slow@1,answer_s=0.02", f"servo.{dead}:off@1")
    bench = servo_bench(*faults, config=LONG)
    bench.driver.enable()
    samples = cycles(bench, 2, ROLLING)
    assert late_ones(caplog) == [late]
    assert {s.status[dead - 1] for s in samples[-20:]} == {Status.TIMEOUT}
    assert samples[-1].status[late - 1] is Status.LATE
    bench.driver.stop()
    last = looks(bench, 10)[-1]
    assert set(last.trouble) == {SERVOS[dead - 1]}


def test_dead_servos_are_not_called_late(servo_bench, caplog):
    bench = servo_bench("servo.2:off@1", "servos:off@2+0.5", config=LONG)
    bench.driver.enable()
    samples = cycles(bench, 4, ROLLING)
    assert late_ones(caplog) == []
    assert samples[-1].status[1] is Status.TIMEOUT
    assert Status.LATE not in {status for s in samples for status in s.status}


@pytest.mark.parametrize(
    "faults",
    [
        ("servos:drop@1,probability=0.15",),
        ("servos:corrupt@1,probability=0.1", "servo.4:drop@1,probability=0.3"),
        ("servos:truncate@1,probability=0.1",),
        ("servo.3:intermittent@1,period_s=0.2,duty=0.4", "servo.6:garbage@1+2"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("fast", ["auto", False])
@pytest.mark.parametrize("prefetch", [False, True])
def test_servos_on_a_bad_line_are_not_called_late(servo_bench, caplog, faults, fast, prefetch):
    config = {**LONG, "fast_sync_read": fast, "prefetch": prefetch}
    bench = servo_bench(*faults, config=config)
    bench.driver.enable()
    cycles(bench, 6, ROLLING)
    assert late_ones(caplog) == []


def test_one_that_is_quick_again_is_taken_back(servo_bench, caplog):
    bench = servo_bench("servo.3:slow@1+1,answer_s=0.05", config=LONG)
    caplog.set_level(logging.WARNING)
    bench.driver.enable()
    samples = cycles(bench, 3, ROLLING)
    assert all(s.ok for s in samples[-50:])
    assert caplog.records[-1].getMessage() == "servos: drive_BR (ID 3) answers in time again"
    assert samples[-1].velocity_rad_s[2] == pytest.approx(2.0, abs=0.05)


def test_the_goals_go_on_and_no_read_takes_long(servo_bench):
    """What a late servo costs a cycle stays within what a lost read may cost; the watchdogs do not trip."""
    bench = servo_bench(config=LONG)
    bench.driver.enable()
    bench.world.faults.add(parse_fault("servo.3:slow@1,answer_s=0.05"))
    took_ns, t_ns = [], bench.clock.now_ns()
    while t_ns < 3_000_000_000:
        bench.driver.read()
        took_ns.append(bench.clock.now_ns() - t_ns)
        bench.driver.command(ROLLING)
        t_ns += CYCLE_NS
        bench.clock.sleep_until_ns(t_ns)
        assert not any(s.tripped for s in bench.bus.servos)
    assert max(took_ns) < CYCLE_NS
    np.testing.assert_allclose(bench.plant.velocity[:4], ROLLING.drive_velocity_rad_s, atol=0.05)


def test_no_reading_is_older_than_it_says(servo_bench):
    """Answers to earlier requests, held up behind the late one, are never taken for the present ones."""
    bench = servo_bench("servo.3:slow@1,answer_s=0.023", config=LONG)
    bench.driver.enable()
    offset = bench.driver.read()[0].position_rad - bench.plant.position
    true, samples = [], []
    while bench.clock.now_ns() < 2_500_000_000:
        samples += bench.driver.read()
        bench.driver.command(ROLLING)
        bench.world.sync_plant()
        true.append((bench.clock.now_ns(), bench.plant.position.copy()))
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 3_000_000)
    for j in range(4):
        good = [s for s in samples if s.status[j] is Status.OK]
        at = np.interp([s.stamp.t_ns for s in good], [t for t, _ in true], [p[j] for _, p in true])
        np.testing.assert_allclose([s.position_rad[j] - offset[j] for s in good], at, atol=0.012)


def test_one_that_is_far_too_late_is_left_alone_and_the_others_are_held(servo_bench, caplog):
    bench = servo_bench("servo.3:slow@1,answer_s=0.4", config=LONG)
    bench.driver.enable()
    cycles(bench, 1.12, ROLLING)
    bench.driver.stop()
    found = looks(bench, 100)
    assert late_ones(caplog) == [3]
    assert {tuple(hold.trouble.items()) for hold in found[-30:]} == {(("drive_BR", "ID 3: answers late"),)}


def test_a_late_servo_cannot_be_enabled_and_is_named(servo_bench):
    bench = servo_bench("servo.3:slow@0.5,answer_s=0.02")
    bench.clock.sleep_until_ns(600_000_000)
    with pytest.raises(DeviceError, match="cannot be enabled: drive_BR answers late") as caught:
        bench.driver.enable()
    assert "return delay time" in caught.value.remedy


def test_a_late_servo_is_an_error_once_it_lasts(servo_bench):
    bench = servo_bench("servo.3:slow@1,answer_s=0.02")
    bench.driver.enable()
    with pytest.raises(
        DeviceError, match=r"nothing usable for 2 s from drive_BR \(ID 3\): answers late"
    ) as caught:
        cycles(bench, 5)
    assert "return delay time" in caught.value.remedy


def test_all_eight_a_little_late_are_still_held(servo_bench):
    bench = servo_bench("servos:slow@1,answer_s=0.002", config={**LONG, "reply_slack_s": 0.006})
    bench.driver.enable()
    samples = cycles(bench, 1.5, ROLLING)
    assert all(Status.LATE in statuses(samples[-20:], j) for j in range(4, 8))
    bench.driver.stop()
    assert all(hold.trouble == {} for hold in looks(bench, 60)[-20:])
