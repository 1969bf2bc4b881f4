"""Voltage and temperature of the servos, by a slow bulk read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.clock import Clock, nanoseconds
from hil.config.servos import ServosConfig
from hil.config.xh430 import TABLE
from hil.drivers.servos import registers as reg
from hil.drivers.servos.bus import Bus
from hil.drivers.servos.packets import GroupRead
from hil.signals import ServoHealth, Stamp, Status

_VOLT = TABLE["present_input_voltage"].scale


class HealthReader:
    """Reads the registers 144..146 of all servos every `health_period_s`."""

    def __init__(self, bus: Bus, config: ServosConfig, clock: Clock, *, fast: bool) -> None:
        self._bus, self._ids, self._clock, self._fast = bus, config.ids, clock, fast
        self._period_ns = nanoseconds(config.health_period_s)
        self._due_ns = clock.now_ns() + self._period_ns
        self._sequence = 0

    def read(self, live_ids: Sequence[int]) -> tuple[ServoHealth, ...]:
        """One sample when it is due, else nothing; servos that are known dead are not asked."""
        now_ns = self._clock.now_ns()
        if now_ns < self._due_ns or not live_ids:
            return ()
        self._due_ns = max(self._due_ns + self._period_ns, now_ns)
        group = GroupRead(live_ids, reg.HEALTH_ADDRESS, reg.HEALTH_LENGTH, fast=self._fast, bulk=True)
        delays = 1 if self._fast else len(live_ids)
        timeout_s = self._bus.port.reply_s(len(group.request), group.expected, delays)
        exchange = self._bus.exchange(group, timeout_s)
        answers = group.answers(exchange.data)
        voltage, celsius = np.full(8, np.nan), np.full(8, np.nan)
        status = [Status.TIMEOUT] * 8
        for joint, servo_id in enumerate(self._ids):
            answer = answers.get(servo_id)
            if answer is None:
                continue
            status[joint] = answer.status
            if answer.status is Status.OK:
                row = np.frombuffer(answer.data, reg.HEALTH_FIELDS)[0]
                voltage[joint], celsius[joint] = row["voltage"] * _VOLT, row["temperature"]
        self._sequence += 1
        middle_ns = (exchange.sent_ns + exchange.received_ns) // 2
        stamp = Stamp(middle_ns, exchange.received_ns, self._sequence)
        return (ServoHealth(stamp, voltage, celsius, tuple(status)),)
