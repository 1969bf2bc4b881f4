"""What the servos are told: radians into raw goals, within the limits of the bench and their own.

A servo ignores a goal beyond its own limits in silence, so those count here too. Drives have velocity
goals, steers position goals, whose zero is the servo's centre.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.config.servos import ServosConfig
from hil.config.xh430 import COUNTS_PER_TURN, POSITION, RAD_PER_COUNT, RAD_S_PER_COUNT, ZERO_COUNTS
from hil.drivers.servos import registers as reg
from hil.drivers.servos.identity import expected_mode
from hil.drivers.servos.packets import GoalWrite
from hil.vocabulary.errors import UsageError
from hil.vocabulary.signals import ServoSetpoint

_FARTHEST = 1_048_575
"""Counts from zero that extended position mode takes."""


class Goals:
    """The eight goals, as they stand.

    Args:
        config: limits and mode of the bench.
        blocks: registers of the eight servos as read at open; the wheels' goals begin at rest, the
            steering's where it stands.
        write: the packet that carries goals.
        device: name in errors.
    """

    def __init__(self, config: ServosConfig, blocks: Sequence[bytes], write: GoalWrite, device: str) -> None:
        self._config, self._write, self._device = config, write, device
        top = np.array([reg.from_block(b, "velocity_limit") for b in blocks[:4]], dtype=np.int64)
        top = np.minimum(top, int(config.velocity_limit_rad_s / RAD_S_PER_COUNT))
        self._one_turn = expected_mode(config, 4) == POSITION
        self._low = np.concatenate((-top, np.full(4, -_FARTHEST)))
        self._high = np.concatenate((top, np.full(4, _FARTHEST)))
        if self._one_turn:
            self._low[4:] = [reg.from_block(b, "min_position_limit") for b in blocks[4:]]
            self._high[4:] = [reg.from_block(b, "max_position_limit") for b in blocks[4:]]
        steering = [reg.from_block(b, "present_position") for b in blocks[4:]]
        self._raw = np.array([0, 0, 0, 0, *steering], dtype=np.int64)

    def packet(self) -> bytes:
        """The one write of a control cycle."""
        return self._write.packet(self._raw)

    def follow(self, setpoint: ServoSetpoint, offset: np.ndarray) -> None:
        """Take a setpoint, clipped.

        Args:
            setpoint: rad and rad/s.
            offset: (8,) counts that the registers have lost (`TurnCounter.offset`).

        Raises:
            UsageError: a goal is not a number.
        """
        limit_rad = self._config.steer_limit_rad
        steer = np.clip(setpoint.steer_position_rad, -limit_rad, limit_rad)
        goals = np.concatenate(
            (
                setpoint.drive_velocity_rad_s / RAD_S_PER_COUNT,
                steer / RAD_PER_COUNT + (ZERO_COUNTS - offset[4:]),
            )
        )
        if not np.isfinite(goals).all():
            raise UsageError(f"{self._device}: a goal is not finite: {setpoint}")
        self._raw = np.minimum(np.maximum(np.rint(goals), self._low), self._high).astype(np.int64)

    def rest(self) -> None:
        """Wheels at rest, the steering's goals as they are."""
        self._raw[:4] = 0

    def hold(self, registers: np.ndarray) -> None:
        """Take the goals at which nothing moves."""
        self._raw = self.still(registers)

    def keep(self, joints: Sequence[int], goals: np.ndarray) -> None:
        """Take some joints' goals out of (8,) raw ones."""
        for j in joints:
            self._raw[j] = goals[j]

    def still(self, registers: np.ndarray) -> np.ndarray:
        """(8,) goals at which nothing moves, from the position registers (8,)."""
        present = registers[4:]
        if self._one_turn:
            present = np.clip(present % COUNTS_PER_TURN, self._low[4:], self._high[4:])
        return np.concatenate((np.zeros(4, dtype=np.int64), present))
