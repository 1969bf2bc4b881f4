"""An emulated device with a defect: what it raises ends the drive, and the robot is looked after."""

import re

import pytest

import hil
from hil.core.errors import UsageError
from hil.fakes.serial_line import SerialLine
from hil.fakes.world import NEVER_NS, Scheduled, World
from hil.robot.trajectories import line

BREAKS_NS = 1_500_000_000


class Still:
    """A plant that only keeps time."""

    def advance(self, t_ns):
        self.t_ns = t_ns


class Ticks(Scheduled):
    """Acts every 10 ns, and raises at one time, while acting or while it is asked."""

    def __init__(self, breaks_ns=NEVER_NS, *, asked=False, error=ZeroDivisionError):
        self.due_ns, self.breaks_ns, self.asked, self.seen, self.error = 10, breaks_ns, asked, [], error

    def next_due_ns(self):
        if self.asked and self.due_ns >= self.breaks_ns:
            raise self.error("broken")
        return self.due_ns

    def on_due(self, t_ns):
        if t_ns >= self.breaks_ns:
            raise self.error("broken")
        self.seen.append(t_ns)
        self.due_ns += 10


@pytest.mark.parametrize("error", [ZeroDivisionError, UsageError])
@pytest.mark.parametrize("asked", [False, True])
def test_a_part_raises_once_and_is_silent_while_the_others_go_on(asked, error):
    world, bad, good = World(Still()), Ticks(30, asked=asked, error=error), Ticks()
    world.add(bad)
    world.add(good)
    with pytest.raises(error):
        world.advance_to(60)
    assert bad.broken
    world.advance_to(60)
    assert (bad.seen, good.seen) == ([10, 20], [10, 20, 30, 40, 50, 60])


@pytest.mark.parametrize(
    ("chip", "held"),
    [
        ("imu", "HELD: .*servo positions, camera"),
        ("thrust", "HELD: .*servo positions, IMU, camera"),
        ("servos", "NOT HELD: moved .*no servo answers"),
    ],
)
def test_the_robot_is_looked_after_whatever_a_chip_raises(monkeypatch, chip, held):
    on_due = SerialLine.on_due

    def broken(self, t_ns):
        if self.chip.name == chip and t_ns >= BREAKS_NS:
            raise ZeroDivisionError("broken")
        on_due(self, t_ns)

    monkeypatch.setattr(SerialLine, "on_due", broken)
    bench = hil.open_bench("emulated", seed=1, overrides={"loop.rate_hz": 50.0})
    with pytest.raises(ZeroDivisionError), bench:
        bench.drive(line((0.0, 0.0, 0.0), (0.2, 0.0, 0.0)))
    assert re.match(held, str(bench.held)), bench.held
