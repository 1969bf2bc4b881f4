"""Frames that a client of the emulated CAN bus has sent periodically (`send_periodic`), in world time."""

from collections.abc import Callable, Sequence

import can
from can.broadcastmanager import (
    LimitedDurationCyclicSendTaskABC,
    ModifiableCyclicTaskABC,
    RestartableCyclicTaskABC,
)

from hil.core.clock import nanoseconds
from hil.fakes.world import NEVER_NS, Scheduled, World


class WorldSendTask(
    LimitedDurationCyclicSendTaskABC, ModifiableCyclicTaskABC, RestartableCyclicTaskABC, Scheduled
):
    """Sends the next of some frames every period, as python-can's thread would on a real bus.

    Args:
        world: time.
        bus: bus that sends the frames.
        messages: one frame, or several with one identifier, sent in turn.
        period: time between two frames, s.
        duration: time after which it ends, s; None for never.
        autostart: True to start at once.
        modifier_callback: called with each frame before it is sent.
    """

    announces = True

    def __init__(
        self,
        world: World,
        bus: can.BusABC,
        messages: can.Message | Sequence[can.Message],
        period: float,
        duration: float | None,
        autostart: bool,
        modifier_callback: Callable[[can.Message], None] | None,
    ) -> None:
        super().__init__(messages, period, duration)
        self._world, self._bus, self._modify = world, bus, modifier_callback
        self._due_ns = self._end_ns = NEVER_NS
        self._index = 0
        world.add(self)
        if autostart:
            self.start()

    def start(self) -> None:
        """Start, or start again, with a frame now."""
        now_ns = self._due_ns = self._world.now_ns
        self._end_ns = NEVER_NS if self.duration is None else now_ns + nanoseconds(self.duration)
        self._world.changed(self)

    def stop(self) -> None:
        """Send no more. Idempotent."""
        self._due_ns = NEVER_NS
        self._world.changed(self)

    def next_due_ns(self) -> int:
        """World time of the next frame."""
        return self._due_ns

    def on_due(self, t_ns: int) -> None:
        """Send a frame."""
        if t_ns >= self._end_ns:
            self._due_ns = NEVER_NS
            return
        self._due_ns = t_ns + nanoseconds(self.period)
        message = self.messages[self._index % len(self.messages)]
        self._index += 1
        if self._modify is not None:
            self._modify(message)
        self._bus.send(message)
