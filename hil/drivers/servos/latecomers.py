"""Servos that answer, but after their time: who they are, by how much, and how long they are waited for.

One of them blocks the reads of all the others, so it is left out of the group read and asked alone. A slow
answer is an answer: who has time (after a stop) waits for it.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator

from hil.drivers.servos.bus import Bus
from hil.vocabulary.clock import Clock, nanoseconds
from hil.vocabulary.signals import SERVOS

_LOG = logging.getLogger(__name__)

_QUIET_S = 0.0025
"""Longer than an adapter keeps bytes to itself."""
_TURNS_NS = nanoseconds(0.005)
"""Eight packets one after the other take longer than one that all write."""
_SPARE_NS, _LONGEST_NS = nanoseconds(0.02), nanoseconds(0.25)
_NOISE = 4096
_PAUSE = 10
"""So many times its lateness one is left alone that blocks the bus for longer than anybody waits."""


class Latecomers:
    """Knows the late ones among the eight.

    Args:
        bus: open bus.
        ids: of the servos.
        clock: the bench clock.
        fast: whether fast sync reads are used.
    """

    def __init__(self, bus: Bus, ids: tuple[int, ...], clock: Clock, *, fast: bool) -> None:
        self._fast, self._bus, self._ids, self._clock = fast, bus, ids, clock
        self._after_ns: dict[int, int] = {}
        self._until_ns = 0
        self._settling = False

    def __contains__(self, joint: int) -> bool:
        return joint in self._after_ns

    def __iter__(self) -> Iterator[int]:
        return iter(self._after_ns)

    def found(self, expected_s: float) -> int | None:
        """The joint whose answer has come too late since the last call.

        Args:
            expected_s: how long an answer may take.
        """
        owed = self._bus.owed
        if owed.late is None:
            self._bus.listen()
        if owed.late is None or self._settling:
            return None
        joint = self._ids.index(owed.late.servo_id)
        new = joint not in self._after_ns
        self._after_ns[joint] = owed.late.after_ns
        self._settling = True
        self._until_ns = owed.late.asked_ns + owed.late.after_ns + (0 if self._fast else _TURNS_NS)
        if new:
            _LOG.warning("%s: %s", self._bus.device, self._told(joint, expected_s))
        return joint

    def _told(self, joint: int, expected_s: float) -> str:
        after_ms, expected_ms = self._after_ns[joint] * 1e-6, expected_s * 1e3
        return (
            f"{SERVOS[joint]} (ID {self._ids[joint]}) answers after up to {after_ms:.0f} ms, "
            f"{expected_ms:.0f} ms are expected: check its return delay time, its cable and its supply"
        )

    def patience_ns(self, joint: int) -> int:
        """How long to wait for the answer of a late one."""
        return self._after_ns[joint] * 3 // 2 + _SPARE_NS

    def pause_ns(self, joint: int) -> int:
        """How long to leave one alone that is too late to be waited for; 0 for one that is not."""
        return _PAUSE * self._after_ns[joint] if self.patience_ns(joint) > _LONGEST_NS else 0

    def heard(self, joint: int, after_ns: int) -> None:
        """A late one that was asked alone has answered."""
        self._after_ns[joint] = after_ns

    def unheard(self, joint: int, waited_ns: int) -> None:
        """A late one that was asked alone has not answered yet."""
        self._after_ns[joint] = max(self._after_ns[joint], waited_ns)
        self._until_ns = self._clock.now_ns() + self.patience_ns(joint)

    def in_time(self, joint: int) -> None:
        """It answers as quickly as the others again."""
        if self._after_ns.pop(joint, None) is not None:
            servo = f"{SERVOS[joint]} (ID {self._ids[joint]})"
            _LOG.warning("%s: %s answers in time again", self._bus.device, servo)

    def hold_up(self) -> bool:
        """Whether what was asked earlier is still to come; what is asked now would get lost in it."""
        if not self._until_ns:
            return False
        if self._clock.now_ns() < self._until_ns:
            return True
        if self._settling:
            if self._bus.gather(_QUIET_S, _NOISE):
                return True
            self._settling = False
            self._bus.owed.forget()
        self._until_ns = 0
        return False
