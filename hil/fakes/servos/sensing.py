"""What the eight servos measure: encoder counts with dither, and the lagging, truncated velocity.

The firmware's velocity is modelled as a difference of encoder counts over 76 ms, 12 ms old, on a fixed
grid of 4 ms: it lags the encoder by 52 ms, stretches a 72 ms fall to about 94 ms and, truncated towards
zero, reads half a count low, as the authors' recordings show. It does not depend on when it is read.
"""

from __future__ import annotations

import numpy as np

from hil.config.servo_models import ServoModel
from hil.fakes.plant_api import Plant
from hil.vocabulary.geometry import Array

GRID_NS = 4_000_000
_GRID_S = GRID_NS * 1e-9
_OLD, _SPAN = 3, 19
_ROWS = 128
_DITHER_COUNTS = 0.25
HISTORY_NS = (_ROWS - _OLD - _SPAN - 1) * GRID_NS


class Sensing:
    """Encoder history of all eight joints, in counts of the joint's own direction from joint angle 0.

    Args:
        plant: tells angles, rates and currents.
        rng: of the dither.
        models: of the eight servos: what their counts and motors are.

    Attributes:
        resistance_ohm: (8,) of the motors.
        ticks: samples of the grid taken so far.
    """

    def __init__(self, plant: Plant, rng: np.random.Generator, models: tuple[ServoModel, ...]) -> None:
        self._plant, self._rng = plant, rng
        span_s = _SPAN * _GRID_S
        self._counts_per_rad = np.array([1.0 / m.rad_per_count for m in models])
        self._velocity_gain = np.array([m.rad_per_count / (span_s * m.rad_s_per_count) for m in models])
        self._counts_per_a = np.array([1.0 / m.a_per_count for m in models])
        self.resistance_ohm: Array = np.array([m.motor.resistance_ohm for m in models])
        self._back_emf_v_s_rad: Array = np.array([m.motor.back_emf_v_s_rad for m in models])
        self._draw()
        self._history = np.tile(self._encoders(np.zeros(8)), (_ROWS, 1))
        self._row = self.ticks = 0
        self._raw_from = 1
        self._flat_history, self._flat_gain = self._history.reshape(-1), np.tile(self._counts_per_rad, _ROWS)
        self._now = np.zeros((3, 8))
        self._now_counts, self._now_velocity, self._now_current = self._now

    def _draw(self) -> None:
        """Dither of the next samples of the grid, counts."""
        self._dither = self._rng.normal(0.0, _DITHER_COUNTS, (_ROWS, 8))
        self._flat_dither = self._dither.reshape(-1)

    def _encoders(self, dither: Array) -> Array:
        """Encoder counts of the present angles, (8,) whole numbers."""
        counts: Array = self._plant.joints()[0] * self._counts_per_rad
        counts += dither
        np.rint(counts, out=counts)
        return counts

    def tick(self) -> None:
        """Take one sample of the grid: the angles; they become counts, all together, when somebody looks."""
        self.ticks += 1
        row = self._row + 1
        if row == _ROWS:
            self._count()
            self._draw()
            row = self._raw_from = 0
        self._row = row
        self._history[row] = self._plant.joints()[0]

    def _count(self) -> None:
        """Make counts of the angles in the history from `_raw_from` on."""
        first, end = self._raw_from, self._row + 1
        if first < end:
            a, b = 8 * first, 8 * end
            raw = self._flat_history[a:b]
            raw *= self._flat_gain[a:b]
            raw += self._flat_dither[a:b]
            np.rint(raw, out=raw)
            self._raw_from = end

    def measure(self) -> tuple[list[int], list[int], list[int]]:
        """`counts` and `velocity` now, and Present Current in its counts."""
        self._count()
        history, row = self._history, self._row
        angles, _, amps = self._plant.joints()
        counts, velocity = self._now_counts, self._now_velocity
        np.multiply(angles, self._counts_per_rad, out=counts)
        counts += self._dither[row]
        np.rint(counts, out=counts)
        np.subtract(history[row - _OLD], history[row - _OLD - _SPAN], out=velocity)
        velocity *= self._velocity_gain
        np.multiply(amps, self._counts_per_a, out=self._now_current)
        all_counts, all_velocities, all_currents = self._now.astype(np.int64).tolist()
        return all_counts, all_velocities, all_currents

    def counts(self, age_ns: int = 0) -> list[int]:
        """Encoder counts now (live), or as they were on the grid `age_ns` ago."""
        if age_ns:
            self._count()
            found = self._history[(self._row - min(age_ns, HISTORY_NS) // GRID_NS) % _ROWS]
        else:
            found = self._encoders(self._dither[self._row])
        return _whole(found)

    def velocity(self, age_ns: int = 0) -> list[int]:
        """Present Velocity in its counts, truncated towards zero."""
        self._count()
        row = self._row - _OLD
        if age_ns:
            row -= min(age_ns, HISTORY_NS) // GRID_NS
        turned = self._history[row % _ROWS] - self._history[(row - _SPAN) % _ROWS]
        return _whole(turned * self._velocity_gain)

    def currents_a(self) -> Array:
        """True motor currents (8,), A."""
        return self._plant.joints()[2]

    def duty(self, voltage_v: float) -> Array:
        """Duty cycle (8,) of the motors, -1..1, by the stall and no-load rows of the data sheet."""
        _, velocity, current = self._plant.joints()
        return np.clip(
            (current * self.resistance_ohm + velocity * self._back_emf_v_s_rad) / voltage_v, -1.0, 1.0
        )


def _whole(values: Array) -> list[int]:
    """(8,) truncated towards zero."""
    return values.astype(np.int64).tolist()  # type: ignore[no-any-return]
