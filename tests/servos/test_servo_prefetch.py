"""Asked ahead: a read need not wait for the bus, its stamp is when the servos took it, nothing collides."""

import numpy as np
import pytest

from hil.core.signals import ServoSetpoint, Status

CYCLE_NS = 5_000_000
ROLLING = ServoSetpoint(np.full(4, 2.0), np.zeros(4))


def cycles(bench, count, setpoint=ROLLING):
    """Read and command at 200 Hz; (samples, how long each read took, health)."""
    samples, took_ns, health = [], [], []
    start_ns = bench.clock.now_ns()
    for k in range(count):
        bench.clock.sleep_until_ns(start_ns + k * CYCLE_NS)
        before_ns = bench.clock.now_ns()
        samples += bench.driver.read()
        took_ns.append(bench.clock.now_ns() - before_ns)
        health += bench.driver.read_health()
        if setpoint is not None:
            bench.driver.command(setpoint)
    return samples, took_ns, health


@pytest.fixture
def ahead(servo_bench):
    """Factory of a driver that asks ahead."""

    def build(*faults, config=None, **values):
        return servo_bench(*faults, config={"prefetch": True, **(config or {})}, **values)

    return build


@pytest.mark.parametrize("setpoint", [ROLLING, None])
def test_no_read_waits_for_the_bus(ahead, setpoint):
    bench = ahead(config={"health_period_s": 0.2})
    if setpoint is not None:
        bench.driver.enable()
    samples, took_ns, health = cycles(bench, 200, setpoint)
    assert all(s.ok for s in samples)
    assert len(health) == pytest.approx(5, abs=1)
    assert max(took_ns[5:]) == 0


@pytest.mark.parametrize("fast", ["auto", False])
def test_health_and_audit_ride_along_with_the_read(servo_bench, fast):
    """A full look is one exchange: a little longer on the wire, never a second transaction."""
    bench = servo_bench(config={"health_period_s": 0.2, "fast_sync_read": fast})
    bench.driver.enable()
    _, took_ns, health = cycles(bench, 400)
    assert len(health) == pytest.approx(10, abs=1)
    assert max(took_ns[2:]) - min(took_ns) < 800_000
    looks = sum(t > min(took_ns) + 100_000 for t in took_ns[2:])
    assert 3 * len(health) <= looks <= 4 * len(health)


@pytest.mark.parametrize("prefetch", [False, True])
def test_the_stamp_is_when_the_servos_took_it(servo_bench, prefetch):
    bench = servo_bench(config={"prefetch": prefetch})
    bench.driver.enable()
    offset = bench.driver.read()[0].position_rad[0] - bench.plant.position[0]
    cycles(bench, 100)
    samples, true = [], []
    for _ in range(50):
        bench.clock.sleep_until_ns(bench.clock.now_ns() + CYCLE_NS)
        (sample,) = bench.driver.read()
        samples.append(sample)
        bench.driver.command(ROLLING)
        bench.world.sync_plant()
        true.append((bench.clock.now_ns(), bench.plant.position[0]))
    at_stamp = np.interp([s.stamp.t_ns for s in samples[1:]], [t for t, _ in true], [p for _, p in true])
    error_s = (np.array([s.position_rad[0] for s in samples[1:]]) - offset - at_stamp) / 2.0
    assert abs(error_s.mean()) < 0.0008
    ages = [s.stamp.host_ns - s.stamp.t_ns for s in samples[1:]]
    assert (min(ages) > 4_000_000) if prefetch else (max(ages) < 3_000_000)


def test_what_is_sent_meanwhile_waits_for_the_answer(ahead):
    """Watching asks at the end of a read; a command right after it must not talk into the answer."""
    bench = ahead()
    bench.driver.enable()
    for _ in range(20):
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 2 * CYCLE_NS)
        assert bench.driver.read()[0].ok
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 2 * CYCLE_NS)
        assert bench.driver.read()[0].ok
        before_ns = bench.clock.now_ns()
        bench.driver.stop()
        assert 500_000 < bench.clock.now_ns() - before_ns < 4_000_000
        bench.driver.command(ROLLING)


def test_an_answer_that_was_lost_is_asked_for_again(ahead):
    bench = ahead("servos:drop@0.2+1,probability=0.01")
    bench.driver.enable()
    samples, _, _ = cycles(bench, 280)
    assert sum(s.ok for s in samples) >= 270
    assert len({s.stamp.t_ns for s in samples}) == len(samples)


def test_an_answer_that_is_late_is_listened_for_from_the_read_on(ahead):
    """Due 2.5 ms and the slack after the request, it is here 1 ms into a read 5 ms after that."""
    bench = ahead("servo.1:slow@0.5+0.005,answer_s=0.003", config={"reply_slack_s": 0.0021})
    bench.driver.enable()
    samples, took_ns, _ = cycles(bench, 200)
    assert all(s.ok for s in samples)
    waited_ns = [t for t in took_ns[3:] if t]
    assert len(waited_ns) == 1
    assert 500_000 < waited_ns[0] < 2_100_000


@pytest.mark.parametrize("servo", [1, 8])
def test_a_silent_servo_costs_the_others_no_sample_and_comes_back(ahead, servo):
    bench = ahead(f"servo.{servo}:off@0.5+1", config={"fail_after_s": 60.0, "health_period_s": 0.2})
    bench.driver.enable()
    samples, _, _ = cycles(bench, 500)
    assert all(s.status[j] is Status.OK for s in samples for j in range(8) if j != servo - 1)
    assert sum(s.status[servo - 1] is Status.OK for s in samples) > 100
    assert samples[200].status[servo - 1] is Status.TIMEOUT
    assert samples[-1].ok
    assert bench.bus.servos[servo - 1].torque


def test_after_a_pause_the_old_answer_is_not_taken_for_the_present(ahead):
    bench = ahead()
    bench.driver.enable()
    cycles(bench, 100)
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 150_000_000)
    now_ns = bench.clock.now_ns()
    (sample,) = bench.driver.read()
    assert sample.ok
    assert sample.stamp.t_ns >= now_ns
