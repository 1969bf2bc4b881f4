"""Schedules full reads of the servos, and makes samples of voltage and temperature."""

from __future__ import annotations

import numpy as np

from hil.config.servo_models import ServoModel
from hil.config.servos import ServosConfig
from hil.core.clock import Clock, nanoseconds
from hil.core.signals import ServoHealth, Stamp, Status
from hil.drivers.servos.cyclic_read import Reading

_LOOKS = 4
"""In the time of one health sample: a watchdog that trips unnoticed stops its wheel, and the
supervisor calls a wheel blocked after half a second."""


class HealthSchedule:
    """Keeps the health of a full look every `health_period_s` until it is asked for."""

    def __init__(self, config: ServosConfig, model: ServoModel, clock: Clock) -> None:
        self._clock, self._volt = clock, model.table["present_input_voltage"].scale
        self._period_ns = nanoseconds(config.health_period_s)
        self._due_ns = clock.now_ns() + self._period_ns
        self._look_ns = clock.now_ns() + self._period_ns // _LOOKS
        self._sequence = 0
        self._kept: tuple[ServoHealth, ...] = ()

    def due(self) -> bool:
        """Whether the next read should be a full look."""
        return self._clock.now_ns() >= self._look_ns

    def note(self, reading: Reading) -> None:
        """Take a full look; it becomes a sample when one is due and anything has answered."""
        now_ns = self._clock.now_ns()
        self._look_ns = now_ns + self._period_ns // _LOOKS
        if now_ns < self._due_ns:
            return
        self._due_ns = max(self._due_ns + self._period_ns, now_ns)
        known = np.array([s is Status.OK for s in reading.status])
        if not known.any():
            return
        self._sequence += 1
        rows = reading.registers
        self._kept = (
            ServoHealth(
                Stamp(reading.taken_ns, reading.received_ns, self._sequence),
                np.where(known, np.array(rows["voltage"]) * self._volt, np.nan),
                np.where(known, rows["temperature"], np.nan),
                reading.status,
            ),
        )

    def take(self) -> tuple[ServoHealth, ...]:
        """The sample that has come up since the last call, if any."""
        kept, self._kept = self._kept, ()
        return kept
