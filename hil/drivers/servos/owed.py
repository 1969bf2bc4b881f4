"""Answers that did not come in time: what arrives later is put to the request that it belongs to.

The bus carries one answer after the other. A servo that answers late holds up the rest of its chain, and
the answers to whatever was asked meanwhile: the first that is owed is to blame, the others only waited.
That it is late, and not dead, is known once its answer has come, complete and with a sound checksum.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from hil.drivers.servos.packets import Answer, GroupRead
from hil.vocabulary.clock import nanoseconds
from hil.vocabulary.signals import Status

_OLDEST_NS = nanoseconds(1.5)
_MOST, _MOST_BYTES = 63, 4096


@dataclass
class _Missed:
    """A request whose answer broke off.

    Attributes:
        waiting: ID of the servo at which it did.
        data: what has been heard since the request.
        in_time: how many bytes of it in its time.
        passed: whether others have answered in time meanwhile: it holds up nobody.
    """

    group: GroupRead
    waiting: int
    sent_ns: int
    data: bytes
    in_time: int
    passed: bool = False


class Late(NamedTuple):
    """A servo that has been found to answer late.

    Attributes:
        after_ns: by when its answer had been heard, from its request on.
        asked_ns: when anything was asked last whose answer may be held up behind it.
    """

    servo_id: int
    after_ns: int
    asked_ns: int


class Owed:
    """What servos still owe.

    Attributes:
        late: who has been found late; what arrives from here on is judged only after `forget`.
    """

    def __init__(self) -> None:
        self.late: Late | None = None
        self._missed: list[_Missed] = []

    def __bool__(self) -> bool:
        return bool(self._missed)

    def forget(self) -> None:
        """All that was owed has come."""
        self._missed.clear()
        self.late = None

    def missed(self, group: GroupRead, sent_ns: int, data: bytes) -> None:
        """A request has not been answered in full in its time."""
        waiting = _first_silent(group.answers(data))
        if waiting is not None and not (data and waiting == group.ids[0]):
            self._missed = self._missed[-_MOST:]
            self._missed.append(_Missed(group, waiting, sent_ns, data, len(data)))

    def answered(self, group: GroupRead) -> None:
        """A request has been answered in full in its time."""
        self._missed = [m for m in self._missed if m.waiting not in group.ids]
        for one in self._missed:
            one.passed = True

    def heard(self, data: bytes, now_ns: int, group: GroupRead | None = None) -> bool:
        """Bytes that have arrived; whether they hold, or follow, an answer that came too late.

        Args:
            data: the bytes.
            now_ns: by when they had arrived.
            group: request in whose time they came, None between requests.
        """
        if self.late is not None:
            return True
        self._missed = [m for m in self._missed if now_ns - m.sent_ns < _OLDEST_NS]
        if not data or not self._missed:
            return False
        own = set() if group is None else {i for i, a in group.answers(data).items() if a.status is Status.OK}
        left: list[_Missed] = []
        for one in self._missed:
            if one.waiting in own:
                continue
            one.data = (one.data + data)[:_MOST_BYTES]
            verdict = _came_late(one)
            if verdict and (one.passed or not any(not m.passed for m in left)):
                asked_ns = max(m.sent_ns for m in self._missed)
                self.late = Late(one.waiting, now_ns - one.sent_ns, asked_ns)
                return True
            if verdict is None:
                left.append(one)
        self._missed = left
        return False


def _came_late(one: _Missed) -> bool | None:
    """Whether what came after its time is the missing answer; None while that is open.

    It is not where something else came first: then the servo only waited for whoever sent that.
    """
    begins = one.group.begins(one.waiting)
    late = one.data[one.in_time :]
    if not (one.group.fast and one.in_time) and late[: len(begins)] != begins[: len(late)]:
        return False
    status = one.group.answers(one.data)[one.waiting].status
    return True if status is Status.OK else None if status is Status.TIMEOUT else False


def _first_silent(answers: dict[int, Answer]) -> int | None:
    return next((i for i, a in answers.items() if a.status is Status.TIMEOUT), None)
