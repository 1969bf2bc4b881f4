"""External encoder against the servo's own angle: what the servo cannot see of its horn and gears.

The servo measures before gear play and horn, the external encoder behind them. Their lasting
difference moves when the horn slips; the part that follows the direction of motion is backlash.
Only settled axes are compared, because the two are not sampled at the same instant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.config.encoders import EncodersConfig
from hil.geometry import Array, wrap_array

_SETTLED_RAD = 0.004
_MOVED_RAD = 0.01
_LEARN = 20
_MEMORY = 0.1


@dataclass(frozen=True)
class CrossCheckResult:
    """Diagnostic per axis, wheel order, shape (4,) each.

    Attributes:
        difference_rad: encoder minus servo, relative to what was learnt at the start; NaN if unknown.
        backlash_rad: difference after forward motion minus after backward motion; NaN until both are known.
        horn_slip: the lasting difference exceeds the threshold.
        backlash_excessive: the play exceeds its limit.
    """

    difference_rad: Array
    backlash_rad: Array
    horn_slip: tuple[bool, ...]
    backlash_excessive: tuple[bool, ...]


class CrossCheck:
    """Follows the difference of two angles of the same axis; feed it once per cycle."""

    def __init__(self, config: EncodersConfig) -> None:
        self._config = config
        self._sign = np.array(config.sign, dtype=np.float64)
        self._zero = np.array(config.zero_rad, dtype=np.float64)
        self.reset()

    def reset(self) -> None:
        """Learn the reference anew (after the horn has been refitted)."""
        self._count = np.zeros(4, dtype=int)
        self._reference = np.zeros(4)
        self._lasting = np.full(4, np.nan)
        self._by_direction = np.full((2, 4), np.nan)
        self._direction = np.full(4, -1, dtype=int)
        self._turned_at = np.full(4, np.nan)
        self._last_servo = np.full(4, np.nan)

    def update(self, encoder_rad: Array, servo_rad: Array) -> CrossCheckResult:
        """Compare one pair of readings.

        Args:
            encoder_rad: (4,) angles of an `EncoderSample`, NaN where unusable.
            servo_rad: (4,) steering angles of the servos, body convention, NaN where unusable.
        """
        settled = np.abs(servo_rad - self._last_servo) < _SETTLED_RAD
        self._last_servo = np.array(servo_rad, dtype=np.float64)
        self._follow_direction(servo_rad)
        raw = wrap_array(self._sign * (encoder_rad - self._zero) - servo_rad)
        for axis in np.flatnonzero(settled & np.isfinite(raw)):
            self._learn(int(axis), float(raw[axis]))
        config = self._config
        difference = wrap_array(self._lasting - self._reference)
        difference[self._count < _LEARN] = np.nan
        backlash = self._by_direction[0] - self._by_direction[1]
        return CrossCheckResult(
            difference_rad=difference,
            backlash_rad=backlash,
            horn_slip=tuple(bool(x) for x in np.abs(difference) > config.horn_slip_threshold_rad),
            backlash_excessive=tuple(bool(x) for x in np.abs(backlash) > config.backlash_limit_rad),
        )

    def _follow_direction(self, servo_rad: Array) -> None:
        fresh = np.isnan(self._turned_at) & np.isfinite(servo_rad)
        self._turned_at[fresh] = servo_rad[fresh]
        moved = servo_rad - self._turned_at
        for direction, hit in enumerate((moved > _MOVED_RAD, moved < -_MOVED_RAD)):
            self._direction[hit] = direction
            self._turned_at[hit] = servo_rad[hit]

    def _learn(self, axis: int, raw_rad: float) -> None:
        count = self._count[axis]
        self._count[axis] = count + 1
        if count < _LEARN:
            self._reference[axis] += (raw_rad - self._reference[axis]) / (count + 1)
            self._lasting[axis] = self._reference[axis]
            return
        self._lasting[axis] += _MEMORY * float(wrap_array(raw_rad - self._lasting[axis]))
        direction = self._direction[axis]
        if direction < 0:
            return
        relative = float(wrap_array(raw_rad - self._reference[axis]))
        known = self._by_direction[direction, axis]
        step = relative if np.isnan(known) else known + _MEMORY * (relative - known)
        self._by_direction[direction, axis] = step
