"""Faults in front of one real device: what arrives of its messages, and when.

The faults alter and withhold only what comes from the device. Emulated devices have theirs at the chip.
"""

from collections.abc import Callable, Iterator

import numpy as np

from hil.core.clock import Clock
from hil.faults.fault import Fault
from hil.faults.messages import Messages
from hil.faults.plan import FaultPlan

_LOSING = ("drop", "silent", "intermittent")
_AGAIN_NS = 250_000
"""Time by which a message that comes twice comes later the second time: that of a CAN frame."""


class LinkFaults:
    """Faults that act on the messages of one real device.

    Args:
        plan: faults of the real devices of the bench.
        name: name of the device.
        rng: random numbers of the draws.
        kinds: kinds of faults that the link of this device can have.
        clock: clock of the bench.
        world_ns: function that returns the time since the bench was opened, ns.
        framing: name of the protocol's framing; empty where whatever arrives at once is one message.

    Attributes:
        hit: number of messages that each fault has altered, delayed or withheld, by its spec.
    """

    def __init__(
        self,
        plan: FaultPlan,
        name: str,
        rng: np.random.Generator,
        kinds: tuple[str, ...],
        clock: Clock,
        world_ns: Callable[[], int],
        framing: str = "",
    ) -> None:
        self._plan, self.name, self.framing = plan, name, framing
        self.clock, self._world_ns = clock, world_ns
        self._messages = Messages(plan, (name,), rng, kinds, on_hit=self._count)
        self.hit: dict[str, int] = {}
        self._first_ns, self._now_ns = plan.first_ns(name), clock.now_ns
        self._begins_ns: int | None = None

    def waiting(self) -> bool:
        """Whether no fault of the device has begun yet."""
        if self._begins_ns is None:
            t_ns = self._world_ns()
            if t_ns == 0:  # the bench is not open yet
                return self._first_ns > 0
            self._begins_ns = self._now_ns() + self._first_ns - t_ns
        return self._now_ns() < self._begins_ns

    def acting(self) -> bool:
        """Whether a fault of the device acts now."""
        return bool(self._now())

    @property
    def over(self) -> bool:
        """Whether all faults have been ended, so that nothing may be held back any longer."""
        return self._plan.empty

    def gone(self) -> bool:
        """Whether the port has failed, as that of a pulled adapter does."""
        if self.waiting():
            return False
        t_ns = self._world_ns()
        fault = self._plan.find(self.name, "unplug", t_ns)
        if fault is not None:
            self._count(fault)
        return fault is not None

    def arriving(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Yield what arrives of a message: how much later, ns, and the bytes, perhaps in pieces."""
        t_ns, late_ns = self._world_ns(), 0
        arrived = self._messages.received(data, t_ns)
        late = self._messages.find("delayed", t_ns) if arrived else None
        if late is not None:
            late_ns = late.delay_ns()
            self._count(late)
        for number, message in enumerate(arrived):
            late_ns += _AGAIN_NS * (number > 0)
            for pause_ns, piece in self._messages.pieces(message, t_ns):
                late_ns += pause_ns
                yield late_ns, piece

    def only_lose(self) -> bool:
        """Whether the faults that act now lose messages, and do nothing else to them."""
        return all(fault.kind in _LOSING for fault in self._now())

    def arrives(self) -> bool:
        """Decide whether a message arrives that can only be lost."""
        return bool(self._messages.copies(self._world_ns()))

    def _now(self) -> tuple[Fault, ...]:
        return () if self._plan.empty or self.waiting() else self._plan.active(self.name, self._world_ns())

    def _count(self, fault: Fault) -> None:
        spec = str(fault)
        self.hit[spec] = self.hit.get(spec, 0) + 1
