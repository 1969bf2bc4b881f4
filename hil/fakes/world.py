"""The emulated world: one plant, one time axis, one seed, and the devices in it.

Devices register as `Scheduled` parts: each gives the time of its next action, and acts at that time. In
virtual time `VirtualClock.sleep_until_ns` advances the world; in real time the emulation server calls
`advance_to` with the monotonic clock. World time starts at 0 in both cases, so the order of events
and every random number depend on the seed alone.

A list holds the parts in the order of their due times. A part with `announces` reports changes of its due
time; any other part is polled before every step.

An exception raised by a part is a defect of that part. It is raised once; from then on the part does not act,
like a device that has failed, so that a bench that closes can still hold the robot with the other devices.
"""

import zlib
from abc import abstractmethod
from bisect import insort
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hil.core.clock import Clock, Task
from hil.core.errors import HilError, UsageError
from hil.fakes.body_interface import Plant
from hil.faults.plan import FaultPlan

NEVER_NS = 1 << 62


class Scheduled(Protocol):
    """A part of the world that acts at times that it plans.

    Attributes:
        alone: its `on_due` never changes the due time of another part.
        announces: True if it calls `World.changed` whenever its due time changes, except in its own `on_due`;
            so it need not be polled.
        broken: set by the world after it has raised an exception; it does not act any more.
    """

    alone: bool = False
    announces: bool = False
    broken: bool = False

    @abstractmethod
    def next_due_ns(self) -> int:
        """World time of the next action, `NEVER_NS` if none is planned."""

    @abstractmethod
    def on_due(self, t_ns: int) -> None:
        """Act; must move `next_due_ns` beyond `t_ns`. The plant has been advanced to `t_ns`."""


class World:
    """Holds the plant, the faults and the scheduled parts, and advances them in order of time.

    Attributes:
        now_ns: world time.
        failures: errors raised by code of another package, by kind of device, which then acts no more.
        enclose: function that wraps every part added from now on.
    """

    def __init__(self, plant: Plant, *, seed: int = 0, faults: FaultPlan | None = None) -> None:
        self.plant = plant
        self.seed = seed
        self.faults = faults if faults is not None else FaultPlan()
        self._parts: list[Scheduled] = []
        self._due_ns: list[int] = []
        self._order: list[tuple[int, int]] = []
        self._places: dict[int, int] = {}
        self._polled: list[tuple[int, Scheduled]] = []
        self.now_ns = 0
        self.failures: dict[str, HilError] = {}
        self.enclose: Callable[[Scheduled], Scheduled] | None = None

    def add(self, part: Scheduled) -> None:
        """Register a part; parts due at the same time act in order of registration."""
        if self.enclose is not None:
            part = self.enclose(part)
        place, announces = len(self._parts), getattr(part, "announces", False)
        self._parts.append(part)
        due_ns = part.next_due_ns() if announces else NEVER_NS
        self._due_ns.append(due_ns)
        insort(self._order, (due_ns, place))
        self._places[id(part)] = place
        if not announces:
            self._polled.append((place, part))

    def changed(self, part: Scheduled) -> None:
        """Update the due time of a part that `announces` its changes."""
        place = self._places.get(id(part))
        if place is not None:
            self._move(place, part.next_due_ns())

    def _move(self, place: int, due_ns: int) -> None:
        """Change the due time of a part in the ordered list."""
        before_ns, order = self._due_ns[place], self._order
        if due_ns != before_ns:
            self._due_ns[place] = due_ns
            order.remove((before_ns, place))
            insort(order, (due_ns, place))

    def _poll(self) -> None:
        """Poll the due times of the parts that do not announce changes."""
        for place, part in self._polled:
            try:
                self._move(place, part.next_due_ns())
            except Exception as error:
                self._broken(place, error)
                raise

    def _broken(self, place: int, error: Exception) -> None:
        """Disable a part that has raised, except for a stop, which may be raised anywhere."""
        if not isinstance(error, HilError) or isinstance(error, UsageError):
            self._parts[place].broken = True
            self._places.pop(id(self._parts[place]), None)
            self._polled = [one for one in self._polled if one[0] != place]
            self._move(place, NEVER_NS)

    def rng(self, name: str) -> np.random.Generator:
        """Return an independent random stream for a named device, fixed by the world's seed."""
        return random_stream(self.seed, name)

    def sync_plant(self) -> None:
        """Integrate the plant up to world time; `advance_to` integrates it only up to the last action."""
        self.plant.advance(self.now_ns)

    def advance_to(self, t_ns: int) -> None:
        """Advance the world to `t_ns`; every part acts at its own due times on the way."""
        if t_ns < self.now_ns:
            return
        parts, due_ns, order, polled, plant = self._parts, self._due_ns, self._order, self._polled, self.plant
        if polled:
            self._poll()
        while order and (first := order[0])[0] <= t_ns:
            now_ns, place = first
            if now_ns > self.now_ns:
                self.now_ns = now_ns
            else:
                now_ns = self.now_ns
            part = parts[place]
            plant.advance(now_ns)
            try:
                part.on_due(now_ns)
                next_ns = part.next_due_ns()
                if order[0] is first:
                    del order[0]
                    insort(order, (next_ns, place))
                    due_ns[place] = next_ns
                else:  # what it did has brought another part forward, or itself
                    self._move(place, next_ns)
            except Exception as error:
                self._broken(place, error)
                raise
            if polled and not getattr(part, "alone", False):
                self._poll()
        self.now_ns = t_ns

    def next_due_ns(self) -> int:
        """World time of the earliest planned action."""
        self._poll()
        return self._order[0][0] if self._order else NEVER_NS


def random_stream(seed: int, name: str) -> np.random.Generator:
    """Return the random stream of a named part of the world for this seed."""
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


@dataclass(eq=False)
class _Planned:
    """A task to be run while a caller sleeps."""

    task: Task
    due_ns: int


class VirtualClock(Clock):
    """Virtual time: it advances only while a caller waits, and then advances the world."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._planned: list[_Planned] = []
        self._acting = False

    def now_ns(self) -> int:
        """World time, ns."""
        return self._world.now_ns

    def sleep_until_ns(self, t_ns: int) -> None:
        """Advance the world to `t_ns`, running scheduled tasks on the way.

        Raises:
            UsageError: `t_ns` is `NEVER_NS` or later.
        """
        if t_ns >= NEVER_NS:
            raise UsageError("the virtual clock was asked to sleep for ever")
        if self._planned and not self._acting:
            self._act(t_ns)
        self._world.advance_to(t_ns)

    def schedule(self, task: Task, due_ns: int) -> Callable[[], None]:
        """Run `task` when a sleep passes its due time; while it sleeps itself, no other task runs."""
        planned = _Planned(task, due_ns)
        self._planned.append(planned)

        def end() -> None:
            planned.due_ns = NEVER_NS
            if planned in self._planned:
                self._planned.remove(planned)

        return end

    def _act(self, t_ns: int) -> None:
        world = self._world
        while self._planned:
            first = self._planned[0]
            for other in self._planned[1:]:
                first = other if other.due_ns < first.due_ns else first
            if first.due_ns > t_ns:
                return
            world.advance_to(first.due_ns)
            self._acting = True
            try:
                next_ns = first.task(world.now_ns)
            finally:
                self._acting = False
            if first.due_ns < NEVER_NS:
                first.due_ns = max(next_ns, world.now_ns + 1)
