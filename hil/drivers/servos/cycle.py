"""The read of every cycle, and what becomes of it when servos do not answer.

A servo that misses a read moves to the end of the list, so that a chain that stops at it loses nobody
else; missing three times, it leaves the list and is asked alone every now and then. So a dead servo costs one
short time-out at a time, never the whole group. When nobody answers it is either the bus or the first of
the chain: somebody else leads the next read, and the guilty one is then known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.clock import NS_PER_S, Clock, nanoseconds
from hil.config.servos import ServosConfig
from hil.drivers.servos import registers as reg
from hil.drivers.servos.bus import Bus, Exchange
from hil.drivers.servos.packets import NO_ANSWER, Answer, GroupRead
from hil.signals import Status

_DEAD_AFTER = 3
_ALL = tuple(range(8))
ALL_OK = (Status.OK,) * 8


@dataclass(frozen=True)
class Reading:
    """One read of all eight.

    Attributes:
        registers: (8,) structured `CYCLE_FIELDS`; zero where `status` is not OK.
        status: per servo, before hardware errors are looked into.
        alert: whether the alert bit was set, per servo.
        revived: joints that answer again after having been left out.
    """

    registers: np.ndarray
    status: tuple[Status, ...]
    alert: tuple[bool, ...]
    sent_ns: int
    received_ns: int
    revived: tuple[int, ...] = ()


_NO_ALERT = (False,) * 8


def _led_by_another(order: tuple[int, ...]) -> tuple[int, ...]:
    return order[1:] + order[:1]


class CycleReader:
    """Reads current, velocity and position of the eight servos.

    Args:
        bus: open bus.
        config: IDs and budgets.
        clock: the bench clock.
        fast: use fast sync reads.
    """

    def __init__(self, bus: Bus, config: ServosConfig, clock: Clock, *, fast: bool) -> None:
        self._bus, self._ids, self._clock, self.fast = bus, config.ids, clock, fast
        self._budget_ns = nanoseconds(config.retry_budget_s)
        self._slack_ns = nanoseconds(config.reply_slack_s)
        self._poll_ns = nanoseconds(config.dead_poll_s)
        self._order = list(_ALL)
        self._missed = [0] * 8
        self._dead: dict[int, int] = {}
        self._groups: dict[tuple[int, ...], tuple[GroupRead, float]] = {}

    @property
    def live_ids(self) -> tuple[int, ...]:
        """IDs that the group read asks, in its order."""
        return tuple(self._ids[j] for j in self._order)

    def read(self) -> Reading:
        """One exchange; a second one for what is missing where the budget allows it."""
        order = tuple(self._order)
        if not order:
            now_ns = self._clock.now_ns()
            return self._poll_dead(Exchange(b"", now_ns, now_ns), dict.fromkeys(_ALL, NO_ANSWER))
        group, timeout_s = self._group(order)
        exchange = self._bus.exchange(group, timeout_s)
        rows = group.quick(exchange.data, reg.CYCLE_FIELDS)
        if rows is not None and order == _ALL:
            if any(self._missed):
                self._missed = [0] * 8
            return Reading(rows, ALL_OK, _NO_ALERT, exchange.sent_ns, exchange.received_ns)
        answers = self._by_joint(group, exchange, order)
        missing = [j for j in order if answers[j].status is not Status.OK]
        if missing:
            deadline_ns = exchange.sent_ns + nanoseconds(timeout_s) - self._slack_ns + self._budget_ns
            answers |= self._again(order, missing, answers, deadline_ns)
        self._keep_book(order, answers)
        return self._poll_dead(exchange, answers)

    def _group(self, joints: tuple[int, ...]) -> tuple[GroupRead, float]:
        found = self._groups.get(joints)
        if found is None:
            ids = [self._ids[j] for j in joints]
            group = GroupRead(ids, reg.CYCLE_ADDRESS, reg.CYCLE_LENGTH, fast=self.fast)
            delays = 1 if self.fast else len(ids)
            timeout_s = self._bus.port.reply_s(len(group.request), group.expected, delays)
            found = self._groups[joints] = (group, timeout_s)
        return found

    def _by_joint(self, group: GroupRead, exchange: Exchange, order: tuple[int, ...]) -> dict[int, Answer]:
        answers = group.answers(exchange.data)
        return {j: answers[self._ids[j]] for j in order}

    def _again(
        self, order: tuple[int, ...], missing: list[int], answers: dict[int, Answer], deadline_ns: int
    ) -> dict[int, Answer]:
        """Ask once more, without the servo at which the answer broke off, if there is time."""
        if len(missing) == len(order):
            joints = _led_by_another(order)
        else:
            suspect = missing[0]
            joints = tuple(j for j in missing if j != suspect or answers[j].status is not Status.TIMEOUT)
        if not joints:
            return {}
        group, timeout_s = self._group(joints)
        left_ns = deadline_ns - self._clock.now_ns()
        if left_ns < nanoseconds(timeout_s) - self._slack_ns:
            return {}
        return self._by_joint(group, self._bus.exchange(group, min(timeout_s, left_ns / NS_PER_S)), joints)

    def _keep_book(self, order: tuple[int, ...], answers: dict[int, Answer]) -> None:
        """Count misses; the first silent servo goes to the end of the list, and then out of it."""
        silent = [j for j in order if answers[j].status is Status.TIMEOUT]
        for j in order:
            if j not in silent:
                self._missed[j] = 0
        if not silent:
            if not self._dead and self._order != list(_ALL):
                self._order = list(_ALL)
            return
        if len(silent) == len(order) > 1:
            self._order = list(_led_by_another(order))
            return
        suspect = silent[0]
        self._missed[suspect] += 1
        self._order.remove(suspect)
        if self._missed[suspect] >= _DEAD_AFTER:
            self._dead[suspect] = self._clock.now_ns() + self._poll_ns
        else:
            self._order.append(suspect)

    def _poll_dead(self, exchange: Exchange, answers: dict[int, Answer]) -> Reading:
        """Ask one of the dead if its time has come, then make a reading of everything."""
        revived = []
        now_ns = self._clock.now_ns()
        for j, due_ns in self._dead.items():
            if now_ns >= due_ns:
                group, timeout_s = self._group((j,))
                answer = self._by_joint(group, self._bus.exchange(group, timeout_s), (j,))[j]
                self._dead[j] = now_ns + self._poll_ns
                if answer.status is Status.OK:
                    answers[j] = answer
                    revived.append(j)
                break
        for j in revived:
            del self._dead[j]
            self._missed[j] = 0
            self._order = sorted([*self._order, j])
        return self._reading(exchange, answers, tuple(revived))

    def _reading(self, exchange: Exchange, answers: dict[int, Answer], revived: tuple[int, ...]) -> Reading:
        registers = np.zeros(8, dtype=reg.CYCLE_FIELDS)
        status, alert = [Status.TIMEOUT] * 8, [False] * 8
        for j, answer in answers.items():
            status[j] = answer.status
            if answer.status is Status.OK:
                registers[j] = np.frombuffer(answer.data, reg.CYCLE_FIELDS)[0]
                alert[j] = bool(answer.error & 0x80)
        return Reading(
            registers, tuple(status), tuple(alert), exchange.sent_ns, exchange.received_ns, revived
        )
