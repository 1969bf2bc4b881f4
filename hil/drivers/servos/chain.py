"""Which servos the group read asks, in which order, and which are asked alone now and then.

A servo that misses a read moves to the end of the list, so that a chain that stops at it loses nobody
else; missing three times, it leaves the list and is asked alone every now and then. So a dead servo costs one
short time-out at a time, never the whole group. When nobody answers at all, it is the bus or the servo at
which the chain stopped first: that one is left out until somebody is heard.
"""

from __future__ import annotations

from collections.abc import Mapping

from hil.drivers.servos.packets import Answer
from hil.vocabulary.clock import nanoseconds
from hil.vocabulary.signals import Status

_DEAD_AFTER = 3
_STUCK_NS = nanoseconds(0.1)
ALL = tuple(range(8))
_NONE_MISSED = [0] * 8


def with_last(order: tuple[int, ...], joint: int) -> tuple[int, ...]:
    """The order with one of them moved to its end."""
    return (*(j for j in order if j != joint), joint)


class Chain:
    """The servos of the group read, by joint.

    Args:
        poll_ns: how often one that has left the list is asked.

    Attributes:
        order: who is asked together.
        alone: those that have left the list, and when they are asked next.
    """

    def __init__(self, poll_ns: int) -> None:
        self._poll_ns = poll_ns
        self.order = list(ALL)
        self.alone: dict[int, int] = {}
        self._missed = list(_NONE_MISSED)
        self._paused: set[int] = set()
        self._suspect: int | None = None
        self._stuck_ns: int | None = None

    def all_answered(self) -> None:
        """All eight have answered together."""
        if self._missed != _NONE_MISSED:
            self._missed = list(_NONE_MISSED)
        self._suspect = None

    def broke_at(self, joint: int) -> None:
        """A chain has stopped at a servo; the first one since somebody was heard counts."""
        if self._suspect is None:
            self._suspect = joint

    def keep_book(self, order: tuple[int, ...], answers: Mapping[int, Answer], now_ns: int) -> None:
        """Take the outcome of a read.

        Args:
            order: who was asked.
            answers: of these.
            now_ns: when that was.
        """
        silent = [j for j in order if answers[j].status is Status.TIMEOUT]
        for j in order:
            if j not in silent:
                self._missed[j] = 0
        if len(silent) == len(order) > 1:
            self._leave_out_suspect(silent[0], now_ns)
            return
        self._suspect = self._stuck_ns = None
        if silent:
            self.broke_at(silent[0])
            self._count_miss(silent[0], now_ns)
        elif not self.alone and self.order != list(ALL):
            self.order = list(ALL)

    def _count_miss(self, joint: int, now_ns: int) -> None:
        self._missed[joint] += 1
        self.order.remove(joint)
        if self._missed[joint] >= _DEAD_AFTER:
            self.alone[joint] = now_ns + self._poll_ns
        else:
            self.order.append(joint)

    def _leave_out_suspect(self, first_silent: int, now_ns: int) -> None:
        """Whom the chain stopped at is left out; after a while of silence it is somebody else's turn."""
        if self._stuck_ns is None:
            self.broke_at(first_silent)
            suspect, self._stuck_ns = self._suspect, now_ns
            if suspect is not None and suspect in self.order:
                self.order.remove(suspect)
                self.alone[suspect] = now_ns
        elif now_ns - self._stuck_ns > _STUCK_NS:
            self._acquit()

    def _acquit(self) -> None:
        """The suspect is asked with the others again, last."""
        if self._suspect is not None and self.alone.pop(self._suspect, None) is not None:
            self.order.append(self._suspect)
        self._suspect = self._stuck_ns = None

    def late(self, joint: int, now_ns: int, pause_ns: int) -> None:
        """It answers late: it is asked alone, and who was suspected in its place is not any more.

        Args:
            joint: index.
            now_ns: when that was found.
            pause_ns: how long it is to be left alone altogether, also in a look; 0 for not at all.
        """
        if self._suspect != joint:
            self._acquit()
        self._suspect = self._stuck_ns = None
        if joint in self.order:
            self.order.remove(joint)
        self._missed[joint] = _DEAD_AFTER
        self._put_off(joint, now_ns, pause_ns)

    def _put_off(self, joint: int, now_ns: int, pause_ns: int) -> None:
        self.alone[joint] = now_ns + max(self._poll_ns, pause_ns)
        self._paused = self._paused - {joint} | ({joint} if pause_ns else set())

    def due(self, now_ns: int, *, everybody: bool) -> list[int]:
        """Who is to be asked alone now; a suspect not before somebody else is heard."""
        stuck = self._stuck_ns is not None and now_ns - self._stuck_ns <= _STUCK_NS
        return [
            j
            for j, due_ns in self.alone.items()
            if (now_ns >= due_ns or (everybody and j not in self._paused))
            and not (stuck and j == self._suspect)
        ]

    def not_revived(self, joint: int, now_ns: int, pause_ns: int) -> None:
        """It has not answered in its time when asked alone; who has missed little goes on with the others."""
        self._missed[joint] += 1
        if self._missed[joint] < _DEAD_AFTER:
            del self.alone[joint]
            self.order.append(joint)
        else:
            self._put_off(joint, now_ns, pause_ns)

    def revived(self, joint: int) -> None:
        """It has answered in its time when it was asked alone."""
        del self.alone[joint]
        self._paused.discard(joint)
        self._missed[joint] = 0
        self.order = sorted([*self.order, joint])
