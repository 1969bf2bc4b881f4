"""The read of every cycle, and what becomes of it when servos do not answer.

Now and then it is a full look: the same exchange shows torque, watchdog, voltage and temperature too, a
fifth of a millisecond more on the wire instead of two exchanges of their own.

Who is asked together and who alone is in `chain`. One that answers late would block the others: it is asked
alone, too, and waited for where there is time (`latecomers`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.config.servos import ServosConfig
from hil.drivers.servos.bus import Bus, Exchange
from hil.drivers.servos.chain import ALL, Chain, with_last
from hil.drivers.servos.latecomers import Latecomers
from hil.drivers.servos.packets import NO_ANSWER, Answer, GroupRead
from hil.drivers.servos.registers import CYCLE_FIELDS, FULL_FIELDS, FULL_LEVEL, RegisterMap
from hil.vocabulary.clock import NS_PER_S, Clock, nanoseconds
from hil.vocabulary.records import quickly_made
from hil.vocabulary.signals import Status

_AGE_NS = 2_500_000
ALL_OK = (Status.OK,) * 8


@quickly_made
@dataclass(frozen=True)
class Reading:
    """One read of all eight.

    Attributes:
        registers: (8,) structured `CYCLE_FIELDS` or `FULL_FIELDS`; zero where `status` is not OK.
        status: per servo, before hardware errors are looked into; `RESET` where a full look has found
            the map of indirect addresses gone.
        alert: whether the alert bit was set, per servo.
        taken_ns, received_ns: when the servos took it, and when it had arrived.
        full: whether it was a full look.
        revived: joints that answer again after having been left out.
    """

    registers: np.ndarray
    status: tuple[Status, ...]
    alert: tuple[bool, ...]
    taken_ns: int
    received_ns: int
    full: bool = False
    revived: tuple[int, ...] = ()


@dataclass(frozen=True)
class _Kind:
    """Which registers a read asks for."""

    address: int
    length: int
    fields: np.dtype[np.void]


_NO_ALERT = (False,) * 8


class CycleReader:
    """Reads current, velocity and position of the eight servos.

    Args:
        bus: open bus.
        config: IDs and budgets.
        registers: of the servos' model.
        clock: the bench clock.
        fast: use fast sync reads.
        mapped: full looks go through the map of indirect addresses.
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
        self._chain = Chain(nanoseconds(config.dead_poll_s))
        self._late = Latecomers(bus, config.ids, clock, fast=fast)
        self._held_up = False
        self._cycle = _Kind(registers.cycle_address, registers.cycle_length, CYCLE_FIELDS)
        self._full = (
            _Kind(registers.audit_data, FULL_FIELDS.itemsize, FULL_FIELDS)
            if mapped
            else _Kind(registers.torque, registers.direct_full_length, registers.direct_full_fields)
        )
        self._groups: dict[tuple[_Kind, tuple[int, ...]], tuple[GroupRead, float]] = {}
        self._kind = self._cycle
        self._asked: tuple[int, ...] = ()
        self._patient_with = b""

    @property
    def live_ids(self) -> tuple[int, ...]:
        """IDs that the group read asks, in its order."""
        return tuple(self._ids[j] for j in self._chain.order)

    def asked(self) -> bool:
        """Whether a request is out whose answer `read` will fetch, or must not be sent for now."""
        return self._held_up or self._bus.asked()

    def ask(self, *, full: bool, after: bytes = b"") -> None:
        """Send the request of the next `read`, behind a packet that nobody answers."""
        self._ask(self._full if full else self._cycle, tuple(self._chain.order), after)

    def look(self, goals: bytes) -> Reading:
        """A full look at everybody, those that have been given up too, in the time that it takes.

        Args:
            goals: packet that is sent again and again while a late one is waited for.
        """
        if self.asked():
            self.read()
        self._ask(self._full, tuple(self._chain.order))
        self._patient_with = goals
        try:
            return self.read()
        finally:
            self._patient_with = b""

    def _ask(self, kind: _Kind, joints: tuple[int, ...], after: bytes = b"") -> None:
        self._leave_out_late()
        self._held_up = self._late.hold_up()
        joints = () if self._held_up else tuple(j for j in joints if j not in self._late)
        self._kind, self._asked = kind, joints
        if joints:
            self._bus.ask(*self._group(kind, joints), after)
        elif after:
            self._bus.send(after)

    def _leave_out_late(self) -> None:
        """Whose answer has come too late is asked alone from now on."""
        if self._bus.owed:
            _, expected_s = self._group(self._cycle, ALL[:1])
            joint = self._late.found(expected_s)
            if joint is not None:
                self._chain.late(joint, self._clock.now_ns(), self._late.pause_ns(joint))

    def read(self) -> Reading:
        """The answer to what was asked; a second exchange for what is missing where the budget allows it.

        When something is missing of what was asked a while ago, everything is asked again, the first silent
        servo last: the parts would be of different times.
        """
        kind, order, began_ns = self._kind, self._asked, self._clock.now_ns()
        if not order:
            nothing = Exchange(b"", began_ns, began_ns, began_ns)
            return self._ask_alone(kind, nothing, dict.fromkeys(ALL, NO_ANSWER))
        group, timeout_s = self._group(kind, order)
        exchange = self._bus.answered(self._slack_ns)
        reading = self._quick(kind, group, exchange, order)
        if reading is not None:
            return reading
        answers = self._by_joint(group, exchange, order)
        missing = [j for j in order if answers[j].status is not Status.OK]
        if missing and began_ns - exchange.sent_ns > _AGE_NS:
            silent = [j for j in missing if answers[j].status is Status.TIMEOUT]
            if silent:
                self._chain.broke_at(silent[0])
                order = with_last(order, silent[0])
            self._ask(kind, order)
            return self.read()
        if missing:
            deadline_ns = exchange.sent_ns + nanoseconds(timeout_s) - self._slack_ns + self._budget_ns
            answers |= self._again(kind, order, missing, answers, deadline_ns)
        self._chain.keep_book(order, answers, self._clock.now_ns())
        return self._ask_alone(kind, exchange, answers)

    def _quick(
        self, kind: _Kind, group: GroupRead, exchange: Exchange, order: tuple[int, ...]
    ) -> Reading | None:
        """The reading of a clean answer of all eight."""
        rows = group.quick(exchange.data, kind.fields)
        if rows is None or order != ALL:
            return None
        full = kind is not self._cycle
        if full and (rows["level"] != FULL_LEVEL).any():
            return None
        self._chain.all_answered()
        return Reading(rows, ALL_OK, _NO_ALERT, exchange.taken_ns, exchange.received_ns, full)

    def _group(self, kind: _Kind, joints: tuple[int, ...]) -> tuple[GroupRead, float]:
        found = self._groups.get((kind, joints))
        if found is None:
            ids = [self._ids[j] for j in joints]
            group = GroupRead(ids, kind.address, kind.length, fast=self.fast)
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
        """Ask once more, without the servo at which the answer broke off, if there is time."""
        if len(missing) == len(order):
            joints = with_last(order, order[0])
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

    def _ask_alone(self, kind: _Kind, exchange: Exchange, answers: dict[int, Answer]) -> Reading:
        """Ask one of those who are asked alone if its time has come (all in a look), then make a reading."""
        held_up, self._held_up = self._held_up, False
        revived = []
        patient = bool(self._patient_with)
        due = [] if held_up else self._chain.due(self._clock.now_ns(), everybody=patient)
        for j in due if patient else due[:1]:
            answer, in_time = self._alone(kind, j)
            if answer.status is Status.OK:
                answers[j] = answer
            if in_time:
                self._late.in_time(j)
                self._chain.revived(j)
                revived.append(j)
            else:
                pause_ns = self._late.pause_ns(j) if j in self._late else 0
                self._chain.not_revived(j, self._clock.now_ns(), pause_ns)
        return self._reading(kind, exchange, answers, tuple(revived))

    def _alone(self, kind: _Kind, joint: int) -> tuple[Answer, bool]:
        """The answer of one servo, and whether it came in its time; in a look a late one is waited for."""
        group, timeout_s = self._group(kind, (joint,))
        late = joint in self._late
        if late and self._patient_with:
            exchange = self._bus.patiently(group, self._late.patience_ns(joint), self._patient_with)
        else:
            exchange = self._bus.exchange(group, timeout_s)
        answer = self._by_joint(group, exchange, (joint,))[joint]
        answered = answer.status is Status.OK
        if late and answered:
            self._late.heard(joint, exchange.received_ns - exchange.sent_ns)
        elif late:
            self._late.unheard(joint, exchange.received_ns - exchange.sent_ns)
        quick_ns = (
            nanoseconds(timeout_s) - self._slack_ns * 7 // 8
        )  # eight of them share the slack of a group
        return answer, answered and (not late or exchange.received_ns - exchange.sent_ns <= quick_ns)

    def _reading(
        self, kind: _Kind, exchange: Exchange, answers: dict[int, Answer], revived: tuple[int, ...]
    ) -> Reading:
        full = kind is not self._cycle
        registers = np.zeros(8, dtype=FULL_FIELDS if full else CYCLE_FIELDS)
        status, alert = [Status.TIMEOUT] * 8, [False] * 8
        for j, answer in answers.items():
            status[j] = answer.status
            if answer.status is not Status.OK:
                continue
            row = np.frombuffer(answer.data, kind.fields)[0]
            if full and row["level"] != FULL_LEVEL:
                status[j] = Status.RESET
                continue
            for name in registers.dtype.names or ():
                registers[name][j] = row[name]
            alert[j] = bool(answer.error & 0x80)
        for j in self._late:
            if status[j] is Status.TIMEOUT:
                status[j] = Status.LATE
        return Reading(
            registers, tuple(status), tuple(alert), exchange.taken_ns, exchange.received_ns, full, revived
        )
