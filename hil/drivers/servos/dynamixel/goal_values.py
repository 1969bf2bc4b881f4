"""Converts commands in radians to raw goals, within the limits of bench and servo.

A servo silently ignores a goal beyond its own limits, so goals are clipped to these too. Drives have velocity
goals, steers position goals, whose zero is the servo's centre.
"""

import math
from collections.abc import Sequence

import numpy as np

from hil.config.servo_models.x_series_codes import POSITION
from hil.config.servos import ServosConfig
from hil.core.errors import UsageError
from hil.core.signals import SERVOS, ServoSetpoint
from hil.drivers.servos.dynamixel.expected_servos import expected_mode
from hil.drivers.servos.dynamixel.packets import GoalWrite
from hil.drivers.servos.dynamixel.register_map import RegisterMap

_FARTHEST = 1_048_575
"""Counts from zero that extended position mode takes."""


class Goals:
    """The present goals of the eight servos.

    Args:
        config: limits and mode of the bench.
        registers: register map of the servos' model.
        blocks: their registers as read at open; the wheels' goals begin at rest, the steering's at its
            present position.
        write: the packet that carries goals.
        device: name in errors.

    Attributes:
        clipped: number of goals, by servo, that were clipped by more than a count; the reader zeroes it.
    """

    def __init__(
        self,
        config: ServosConfig,
        registers: RegisterMap,
        blocks: Sequence[bytes],
        write: GoalWrite,
        device: str,
    ) -> None:
        self._limit_rad, self._write, self._device = config.steer_limit_rad, write, device
        self._model, read = registers.model, registers.from_block
        self._rad_s, self._rad = self._model.rad_s_per_count, self._model.rad_per_count
        top = np.array([read(b, "velocity_limit") for b in blocks[:4]], dtype=np.int64)
        top = np.minimum(top, int(config.velocity_limit_rad_s / self._rad_s))
        self._one_turn = expected_mode(config, 4) == POSITION
        self._low = np.concatenate((-top, np.full(4, -_FARTHEST)))
        self._high = np.concatenate((top, np.full(4, _FARTHEST)))
        if self._one_turn:
            self._low[4:] = [read(b, "min_position_limit") for b in blocks[4:]]
            self._high[4:] = [read(b, "max_position_limit") for b in blocks[4:]]
        steering = [read(b, "present_position") for b in blocks[4:]]
        self._limits = list(zip(self._low.tolist(), self._high.tolist(), strict=True))
        self._raw = [0, 0, 0, 0, *steering]
        self.clipped = [0] * len(SERVOS)

    def packet(self) -> bytes:
        """The write packet of a control cycle."""
        return self._write.packet(self._raw)

    def follow(self, setpoint: ServoSetpoint, offset: Sequence[int]) -> None:
        """Take a setpoint, clipped; goals that are clipped are counted.

        Args:
            setpoint: goals of the servos, rad and rad/s.
            offset: (8,) counts that the registers have lost (`MultiTurnCounter.offset`).

        Raises:
            UsageError: a goal is not a number.
        """
        limit_rad, rad, zero_counts, beyond = self._limit_rad, self._rad, self._model.zero_counts, set[int]()
        goals = [v / self._rad_s for v in setpoint.drive_velocity_rad_s.tolist()]
        for j, angle in enumerate(setpoint.steer_position_rad.tolist(), 4):
            if not -limit_rad <= angle <= limit_rad:
                if abs(angle) > limit_rad + rad:
                    beyond.add(j)
                angle = min(max(angle, -limit_rad), limit_rad)
            goals.append(angle / rad + (zero_counts - offset[j]))
        if not all(map(math.isfinite, goals)):
            raise UsageError(f"{self._device}: a goal is not finite: {setpoint}")
        raw = list(map(round, goals))
        for j, (low, high) in enumerate(self._limits):
            if not low <= raw[j] <= high:
                if not low - 1 <= raw[j] <= high + 1:
                    beyond.add(j)
                raw[j] = low if raw[j] < low else high
        self._raw = raw
        for j in beyond:
            self.clipped[j] += 1

    def rest(self) -> None:
        """Set the wheels' goals to rest; keep the steering's."""
        self._raw[:4] = [0] * 4

    def hold(self, registers: np.ndarray) -> None:
        """Set the goals at which nothing moves."""
        self._raw = self.still(registers).tolist()

    def keep(self, joints: Sequence[int], goals: np.ndarray) -> None:
        """Set the goals of some joints from (8,) raw goals."""
        for j in joints:
            self._raw[j] = int(goals[j])

    def still(self, registers: np.ndarray) -> np.ndarray:
        """(8,) goals at which nothing moves, from the position registers (8,)."""
        present = registers[4:]
        if self._one_turn:
            present = np.clip(present % self._model.counts_per_turn, self._low[4:], self._high[4:])
        return np.concatenate((np.zeros(4, dtype=np.int64), present))
