"""Reads all servos in every cycle, and handles those that do not answer.

Now and then it makes a full read: the same exchange also returns torque, watchdog, voltage and temperature,
which takes a fifth of a millisecond more on the wire instead of two exchanges of their own.

A servo that misses a read moves to the end of the list, so that an answer that breaks off at it loses no
other servo, and stays there until none has missed a read for a while: one that answers every other read costs
only itself. After three misses it leaves the list and is polled alone now and then. So a dead servo costs one
short timeout at a time, never the whole group. When no servo answers, the fault is in the bus or in the
first servo: another servo leads the next read, which shows which of the two it is.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hil.config.servos import ServosConfig
from hil.core.clock import NS_PER_S, Clock, nanoseconds
from hil.core.signals import SERVOS, Status
from hil.drivers.servos.dynamixel.bus import Bus, Exchange
from hil.drivers.servos.dynamixel.late_servos import LatencyProbe
from hil.drivers.servos.dynamixel.packets import NO_ANSWER, Answer, GroupRead
from hil.drivers.servos.dynamixel.register_map import (
    CYCLE_FIELDS,
    FULL_FIELDS,
    FULL_LEVEL,
    Fields,
    RegisterMap,
)

_DEAD_AFTER = 3
_AGE_NS = 2_500_000
_REORDERED_NS = nanoseconds(1.0)
"""Time without a miss after which the list has its first order again."""
_ALL = tuple(range(len(SERVOS)))
_NONE_MISSED = [0] * len(SERVOS)
_FULL_LEVELS = (FULL_LEVEL,) * len(SERVOS)
ALL_OK = (Status.OK,) * len(SERVOS)


class Reading(NamedTuple):
    """The result of one read of all eight servos.

    Attributes:
        registers: raw counts (8,) of `CYCLE_FIELDS` or `FULL_FIELDS` by name; 0 where `status` is not OK.
        status: status of each servo, before hardware errors are considered; `RESET` where a full read has
            found the map of indirect addresses gone.
        alert: alert bit of each servo.
        taken_ns, received_ns: times at which the servos sampled it, and at which it had arrived.
        full: True for a full read.
        revived: joints that answer again after having been left out.
    """

    registers: Mapping[str, Sequence[int]]
    status: tuple[Status, ...]
    alert: tuple[bool, ...]
    taken_ns: int
    received_ns: int
    full: bool = False
    revived: tuple[int, ...] = ()


class _Kind(NamedTuple):
    """Address and registers of a read."""

    address: int
    fields: Fields


_NO_ALERT = (False,) * len(SERVOS)


def _with_last(order: tuple[int, ...], joint: int) -> tuple[int, ...]:
    return (*(j for j in order if j != joint), joint)


class CycleReader:
    """Reads current, velocity and position of the eight servos.

    Args:
        bus: open bus.
        config: IDs and budgets.
        registers: register map of the servos' model.
        clock: the bench clock.
        fast: True to use fast sync reads.
        mapped: full reads go through the map of indirect addresses.
    """

    def __init__(
        self,
        bus: Bus,
        config: ServosConfig,
        registers: RegisterMap,
        clock: Clock,
        *,
        fast: bool,
        mapped: bool,
    ) -> None:
        self._bus, self._ids, self._clock, self.fast = bus, config.ids, clock, fast
        self._budget_ns = nanoseconds(config.retry_budget_s)
        self._slack_ns = nanoseconds(config.reply_slack_s)
        self._poll_ns = nanoseconds(config.dead_poll_s)
        self._order = list(_ALL)
        self._missed, self._missed_ns = list(_NONE_MISSED), 0
        self._dead: dict[int, int] = {}
        self._cycle = _Kind(registers.cycle_address, CYCLE_FIELDS)
        self._full = (
            _Kind(registers.audit_data, FULL_FIELDS)
            if mapped
            else _Kind(registers.torque, registers.direct_full_fields)
        )
        self._groups: dict[tuple[_Kind, tuple[int, ...]], tuple[GroupRead, float]] = {}
        self._kind, self._asked = self._cycle, _ALL[:0]
        self._thorough = self._incomplete = False
        self._roll = LatencyProbe(bus, config.ids, clock, watchdog_s=config.watchdog_s)

    @property
    def live_ids(self) -> tuple[int, ...]:
        """IDs of the servos in the group read, in its order."""
        return tuple(self._ids[j] for j in self._order)

    def asked(self) -> bool:
        """Whether a request is pending whose answer `read` will fetch."""
        return self._bus.asked()

    def ask(self, *, full: bool, after: bytes = b"") -> None:
        """Send the request of the next `read`, after a packet without an answer."""
        self._ask(self._full if full else self._cycle, tuple(self._order), after)

    def look(self) -> Reading:
        """A full read of all servos, also of those that were left out; may take longer than a cycle."""
        if self.asked():
            self.read()
        if self._incomplete and self._roll.is_due():
            for joint in self._roll.probe_all(lambda j: self._group(self._full, (j,))):
                self._leave_out(joint)
        self._ask(self._full, tuple(self._order))
        self._thorough = True
        try:
            reading = self.read()
        finally:
            self._thorough = False
        self._incomplete = Status.TIMEOUT in reading.status
        return reading

    def late(self) -> dict[str, str]:
        """Servos that were found to answer late, by name, with what to do about it."""
        return self._roll.in_words()

    def _ask(self, kind: _Kind, joints: tuple[int, ...], after: bytes = b"") -> None:
        self._kind, self._asked = kind, joints
        if joints:
            self._bus.ask(*self._group(kind, joints), after)
        elif after:
            self._bus.send(after)

    def read(self) -> Reading:
        """Fetch the pending answer; a second exchange reads missing servos where the budget allows it.

        When an answer to an old request is incomplete, all servos are read again, the first silent one last:
        otherwise the parts would be of different times.
        """
        kind, order, began_ns = self._kind, self._asked, self._clock.now_ns()
        if not order:
            nothing = Exchange(b"", began_ns, began_ns, began_ns)
            return self._poll_dead(kind, nothing, dict.fromkeys(_ALL, NO_ANSWER))
        group, timeout_s = self._group(kind, order)
        exchange = self._bus.answered(self._slack_ns)
        reading = self._quick(kind, group, exchange, order)
        if reading is not None:
            return reading
        answers = self._by_joint(group, exchange, order)
        missing = [j for j in order if answers[j].status is not Status.OK]
        if missing and began_ns - exchange.sent_ns > _AGE_NS:
            silent = [j for j in missing if answers[j].status is Status.TIMEOUT]
            self._ask(kind, _with_last(order, silent[0]) if silent else order)
            return self.read()
        if missing:
            deadline_ns = exchange.sent_ns + nanoseconds(timeout_s) - self._slack_ns + self._budget_ns
            answers |= self._again(kind, order, missing, answers, deadline_ns)
        self._count_misses(order, answers)
        return self._poll_dead(kind, exchange, answers)

    def _quick(
        self, kind: _Kind, group: GroupRead, exchange: Exchange, order: tuple[int, ...]
    ) -> Reading | None:
        """The reading of a clean answer of all eight; None for any other."""
        registers = group.quick(exchange.data)
        if registers is None or order != _ALL:
            return None
        full = kind is not self._cycle
        if full and registers["level"] != _FULL_LEVELS:
            return None
        if self._missed != _NONE_MISSED:
            self._missed = list(_NONE_MISSED)
        values = (registers, ALL_OK, _NO_ALERT, exchange.taken_ns, exchange.received_ns, full, ())
        return Reading(*values)

    def _group(self, kind: _Kind, joints: tuple[int, ...]) -> tuple[GroupRead, float]:
        found = self._groups.get((kind, joints))
        if found is None:
            ids = [self._ids[j] for j in joints]
            fields = kind.fields
            group = GroupRead(ids, kind.address, fields.length, fast=self.fast, fields=fields)
            delays = 1 if self.fast else len(ids)
            timeout_s = self._bus.port.reply_s(len(group.request), group.expected, delays)
            found = self._groups[kind, joints] = (group, timeout_s)
        return found

    def _by_joint(self, group: GroupRead, exchange: Exchange, order: tuple[int, ...]) -> dict[int, Answer]:
        answers = group.answers(exchange.data)
        return {j: answers[self._ids[j]] for j in order}

    def _again(
        self,
        kind: _Kind,
        order: tuple[int, ...],
        missing: list[int],
        answers: dict[int, Answer],
        deadline_ns: int,
    ) -> dict[int, Answer]:
        """Read missing servos once more, except the one at which the answer broke off, if there is time."""
        if len(missing) == len(order):
            joints = _with_last(order, order[0])
        else:
            suspect = missing[0]
            joints = tuple(j for j in missing if j != suspect or answers[j].status is not Status.TIMEOUT)
        if not joints:
            return {}
        group, timeout_s = self._group(kind, joints)
        left_ns = deadline_ns - self._clock.now_ns()
        if left_ns < nanoseconds(timeout_s) - self._slack_ns:
            return {}
        return self._by_joint(group, self._bus.exchange(group, min(timeout_s, left_ns / NS_PER_S)), joints)

    def _count_misses(self, order: tuple[int, ...], answers: dict[int, Answer]) -> None:
        """Count misses; the first silent servo goes to the end of the list, and then out of it."""
        silent = [j for j in order if answers[j].status is Status.TIMEOUT]
        for j in order:
            if j not in silent:
                self._missed[j] = 0
        now_ns = self._clock.now_ns()
        if not silent:
            if not self._dead and now_ns - self._missed_ns > _REORDERED_NS:
                self._order = list(_ALL)
            return
        self._missed_ns = now_ns
        if len(silent) == len(order) > 1:
            self._order = list(_with_last(order, order[0]))
            return
        suspect = silent[0]
        self._missed[suspect] += 1
        if self._missed[suspect] >= _DEAD_AFTER:
            self._leave_out(suspect)
        else:
            self._order.remove(suspect)
            self._order.append(suspect)

    def _leave_out(self, joint: int) -> None:
        """Take a servo out of the group read; it is polled alone every `dead_poll_s`."""
        self._dead[joint] = self._clock.now_ns() + self._poll_ns
        if joint in self._order:
            self._order.remove(joint)

    def _poll_dead(self, kind: _Kind, exchange: Exchange, answers: dict[int, Answer]) -> Reading:
        """Poll a servo that was left out when it is due (in `look`: all of them), then make a reading."""
        if self._thorough and self._asked:
            self._ask_spoilt_alone(kind, exchange, answers)
        revived = []
        now_ns = self._clock.now_ns()
        for j, due_ns in self._dead.items():
            if self._roll.is_too_late(j):
                continue
            if self._thorough or now_ns >= due_ns:
                group, timeout_s = self._group(kind, (j,))
                alone = self._roll.ask(j, group, timeout_s, patient=self._thorough)
                answer = self._by_joint(group, alone, (j,))[j]
                self._dead[j] = now_ns + self._poll_ns
                if answer.status is Status.OK:
                    answers[j] = answer
                    if j not in self._roll.late_s:
                        revived.append(j)
                if not self._thorough:
                    break
        for j in revived:
            del self._dead[j]
            self._missed[j] = 0
            self._order.append(j)
        return self._reading(kind, exchange, answers, tuple(revived))

    def _ask_spoilt_alone(self, kind: _Kind, exchange: Exchange, answers: dict[int, Answer]) -> None:
        """Read servos with a damaged answer again, one by one: on a noisy bus a short answer gets through.

        A servo is missing in an answer of full length where bytes of another one came twice. Where most
        answers are damaged, the time is kept for setting servos up, which needs no answers.
        """
        kinds = {Status.CRC}
        if len(exchange.data) >= self._group(kind, self._asked)[0].expected:
            kinds.add(Status.TIMEOUT)
        spoilt = [j for j in self._asked if answers[j].status in kinds]
        for joint in spoilt if len(spoilt) <= len(_ALL) // 2 else ():
            answer = self._bus.read(self._ids[joint], kind.address, kind.fields.length, attempts=1)
            if answer.status is not Status.OK:
                return
            answers[joint] = answer

    def _reading(
        self, kind: _Kind, exchange: Exchange, answers: dict[int, Answer], revived: tuple[int, ...]
    ) -> Reading:
        full = kind is not self._cycle
        registers = {name: [0] * len(SERVOS) for name in kind.fields.names}
        status, alert = [Status.TIMEOUT] * len(SERVOS), [False] * len(SERVOS)
        for j, answer in answers.items():
            status[j] = answer.status
            if answer.status is not Status.OK:
                continue
            row = kind.fields.of(answer.data)
            if full and row["level"] != FULL_LEVEL:
                status[j] = Status.RESET
                continue
            for name, raw in row.items():
                registers[name][j] = raw
            alert[j] = bool(answer.error & 0x80)
        return Reading(
            registers, tuple(status), tuple(alert), exchange.taken_ns, exchange.received_ns, full, revived
        )
