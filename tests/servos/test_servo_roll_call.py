"""Servos that answer late: after a stop they are found, named, waited for, and taken back once quick.

One late answer holds up everything that is asked behind it on the bus, so that no other servo is heard.
"""

import numpy as np
import pytest
from servo_cycles import ROLLING, cycles

from hil.core.signals import SERVOS, Status
from hil.faults.fault import parse_fault

LONG = {"fail_after_s": 60.0}
SECOND = 1_000_000_000


def stopped(bench, run_s=1.12):
    """A bench that was driven until its servos fell silent, and is stopped."""
    bench.driver.enable()
    cycles(bench, run_s, ROLLING)
    bench.driver.stop()
    return bench


def looks(bench, count):
    """As after a stop: the servos are looked after again and again; what they say, look by look."""
    found = []
    for _ in range(count):
        found.append(bench.driver.look_after())
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 20_000_000)
    return found


IN_TURN, AHEAD = {"fast_sync_read": False}, {"prefetch": True}


@pytest.mark.parametrize(
    ("servo_id", "answer_s", "config"),
    [(2, 0.02, {}), (1, 0.05, IN_TURN), (8, 0.02, IN_TURN), (3, 0.01, AHEAD)],
    ids=str,
)
def test_a_late_servo_is_named_waited_for_and_affects_no_other_servo(servo_bench, servo_id, answer_s, config):
    bench = stopped(servo_bench(f"servo.{servo_id}:slow@1,answer_s={answer_s}", config={**LONG, **config}))
    last = looks(bench, 25)[-5:]
    assert all(hold.trouble == {} and hold.wanted for hold in last)
    assert all(np.isfinite(hold.position_rad).all() for hold in last)
    for hold in last:
        ((name, text),) = hold.late.items()
        assert name == SERVOS[servo_id - 1]
        assert text.startswith(f"ID {servo_id}: answers after ")
        assert 1e3 * answer_s <= float(text.split("after ")[1].split(" ms")[0]) <= 1e3 * answer_s + 10
    np.testing.assert_allclose(bench.plant.velocity[:4], 0.0, atol=0.01)


@pytest.mark.parametrize("answer_s", [0.08, 0.2])
def test_one_that_is_too_late_to_be_waited_for_is_named_and_left_alone(servo_bench, answer_s):
    """Waiting for it would trip the watchdogs of the others; once it is quick, it is found again."""
    bench = stopped(servo_bench(f"servo.3:slow@1+4,answer_s={answer_s}", config=LONG))
    for hold in looks(bench, 40)[-5:]:
        assert set(hold.late) == {"drive_BR"}
        assert set(hold.trouble) == {"drive_BR"}
    bench.clock.sleep_until_ns(7_000_000_000)
    last = looks(bench, 10)[-1]
    assert (last.late, last.trouble) == ({}, {})


@pytest.mark.parametrize(("pair", "fast"), [((3, 8), "auto"), ((1, 2), False)])
def test_two_late_servos_are_both_named_and_no_other(servo_bench, pair, fast):
    faults = [f"servo.{i}:slow@1,answer_s=0.02" for i in pair]
    last = looks(stopped(servo_bench(*faults, config={**LONG, "fast_sync_read": fast})), 25)[-1]
    assert set(last.late) == {SERVOS[i - 1] for i in pair}
    assert last.trouble == {}


@pytest.mark.parametrize(("late", "dead"), [(3, 5), (8, 1)])
def test_a_late_and_a_dead_servo_are_distinguished(servo_bench, late, dead):
    bench = servo_bench(f"servo.{late}:slow@1,answer_s=0.02", f"servo.{dead}:off@1", config=LONG)
    last = looks(stopped(bench), 30)[-1]
    assert set(last.late) == {SERVOS[late - 1]}
    assert set(last.trouble) == {SERVOS[dead - 1]}


def test_many_dead_ones_do_not_make_a_roll_call_long(servo_bench):
    """Who restarts meanwhile waits for its torque."""
    dead = [f"servo.{i}:off@1" for i in (1, 2, 3, 5, 6)]
    bench = stopped(servo_bench("servo.8:slow@1,answer_s=0.02", *dead, config=LONG))
    found, took_ns = [], []
    for _ in range(60):
        began_ns = bench.clock.now_ns()
        found.append(bench.driver.look_after())
        took_ns.append(bench.clock.now_ns() - began_ns)
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 20_000_000)
    assert max(took_ns) < 800_000_000
    assert set(found[-1].late) == {"steer_FR"}
    assert set(found[-1].trouble) == {"drive_FL", "drive_BL", "drive_BR", "steer_FL", "steer_BL"}


def test_what_a_late_servo_has_lost_is_put_right(servo_bench):
    bench = stopped(servo_bench("servo.3:slow@1,answer_s=0.03", config=LONG))
    looks(bench, 25)
    bench.world.faults.add(parse_fault(f"servo.3:reset@{bench.clock.now_ns() / SECOND + 0.05:.3f}"))
    found = looks(bench, 60)
    assert any("drive_BR" in hold.trouble for hold in found)
    assert found[-1].trouble == {}
    assert bench.bus.servos[2].torque


def test_one_that_is_quick_again_is_driven_again(servo_bench):
    bench = stopped(servo_bench("servo.3:slow@1+1,answer_s=0.02", config=LONG))
    assert looks(bench, 10)[-1].late
    bench.clock.sleep_until_ns(2_100_000_000)
    assert looks(bench, 3)[-1].late == {}
    bench.driver.enable()
    samples = cycles(bench, 1, ROLLING)
    assert all(s.status == (Status.OK,) * 8 for s in samples[2:])


@pytest.mark.parametrize(
    "faults",
    [
        ("servos:drop@1,probability=0.3",),
        ("servos:corrupt@1,probability=0.3",),
        ("servos:off@1+0.5",),
        ("servo.2:off@1",),
        ("servo.2:intermittent@1",),
        ("servos:brownout@1+0.3",),
    ],
    ids=str,
)
def test_who_is_silent_lost_or_garbled_is_not_called_late(servo_bench, faults):
    found = looks(stopped(servo_bench(*faults, config=LONG)), 40)
    assert all(hold.late == {} for hold in found)
