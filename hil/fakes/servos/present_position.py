"""Present Position of a servo: encoder, direction, turns and homing offset, in 32-bit register counts."""

from __future__ import annotations

from hil.config.servo_models import ServoModel

_WORD, _HALF_WORD = 1 << 32, 1 << 31


class PositionRegister:
    """Turns encoder counts (joint direction, from joint angle 0) into what the register shows, and back.

    Args:
        model: how the servo counts.
        zero: encoder counts of the chip at joint angle 0.

    Attributes:
        encoder: as last sensed.
        sign: -1 in reverse mode.
        homing: homing offset in force.
    """

    def __init__(self, model: ServoModel, zero: int) -> None:
        self._turn_counts, self._rad_per_count = model.counts_per_turn, model.rad_per_count
        self._zero, self._base = zero, zero
        self.encoder, self.sign, self.homing = 0, 1, 0

    @property
    def present(self) -> int:
        """Present Position; it wraps at 32 bits."""
        return (self.sign * self.encoder + self._base + self.homing + _HALF_WORD) % _WORD - _HALF_WORD

    def wrap(self) -> None:
        """Count from one turn again; a homing offset still applies on top."""
        base = self.sign * self._zero
        turns = (self.sign * self.encoder + base) // self._turn_counts
        self._base = base - turns * self._turn_counts

    def slip(self, counts: int) -> None:
        """The encoder's magnet turns on its shaft."""
        self._zero += counts
        self._base += self.sign * counts

    def joint_rad(self, counts: float) -> float:
        """Joint angle at which the register would show `counts`."""
        return self.sign * (counts - self._base - self.homing) * self._rad_per_count
