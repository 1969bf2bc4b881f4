"""A sink or a device that fails keeps no robot from being held, checked, and left with its devices closed."""

import threading

import pytest

import hil
from hil.core.errors import SafetyStop
from hil.core.interfaces import Sink
from hil.drivers.servos.dynamixel.keep_alive import KeepAlive


class Fails(Sink):
    """A sink that raises in one of its functions."""

    def __init__(self, where):
        setattr(self, where, self._fail)

    def _fail(self, *given):
        raise RuntimeError("disk full")

    def write(self, record):
        pass

    def close(self):
        pass


@pytest.mark.parametrize("where", ["watched", "note", "close"])
def test_a_sink_that_fails_keeps_no_robot_from_being_checked(where, caplog):
    with hil.open_bench("emulated", seed=1) as bench:
        bench.add_sink(Fails(where))
        bench.devices.actuators().enable()
    assert bench.held.state == "HELD"
    assert not bench.devices.servos.identity()
    assert caplog.text.count("Fails has failed: RuntimeError: disk full") == 1


def test_a_sink_that_fails_at_the_stop_does_not_hide_its_reason(caplog):
    class FailsAtTheStop(Sink):
        def write(self, record):
            if any(event.level == "error" for event in record.events):
                raise RuntimeError("disk full")

        def close(self):
            pass

    with hil.open_bench("emulated_floor", seed=1, faults=["servos:silent@1.0"]) as bench:
        bench.add_sink(FailsAtTheStop())
        with pytest.raises(SafetyStop, match="stale_servos"):
            bench.observe(2.0)
    assert "disk full" in caplog.text


def test_a_fan_that_cannot_be_raised_keeps_no_robot_from_being_checked(caplog):
    with hil.open_bench("emulated", seed=1, faults=["adhesion:off@1.0"]) as bench:
        bench.devices.get("adhesion").brace = Fails("brace").brace
        bench.devices.actuators().enable()
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 1_500_000_000)
    assert bench.held.state == "NOT HELD"
    assert "not checked" not in bench.held.why
    assert "adhesion has failed: RuntimeError: disk full" in caplog.text


def test_a_fan_whose_driver_fails_keeps_no_robot_from_being_checked():
    with hil.open_bench("emulated", seed=1) as bench:
        bench.devices.actuators().enable()
        bench.devices.get("adhesion").read = Fails("read").read
    assert "not checked" not in bench.held.why
    assert "nothing by the fan's speed" in bench.held.why or "is silent" in bench.held.why


class Scheduled:
    """A clock that calls a task by hand."""

    def now_ns(self):
        return 0

    def schedule(self, task, due_ns):
        self.task = task
        return lambda: None


def test_servos_are_looked_after_again_whatever_has_failed_before(caplog):
    looks = iter([IndexError("list index out of range"), None])

    def visit():
        if error := next(looks):
            raise error
        return True

    clock, lock = Scheduled(), threading.Lock()
    alive = KeepAlive(clock, lock, visit, watchdog_s=0.1)
    alive.begin()
    clock.task(1_000_000_000)
    assert not lock.locked()
    assert clock.task(1_000_000_000) > 0
    assert next(looks, "all looked") == "all looked"
    assert "IndexError: list index out of range" in caplog.text
