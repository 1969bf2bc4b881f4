"""What the eight servos measure: encoder counts with dither, and the lagging, truncated velocity.

The firmware's velocity is modelled as a difference of encoder counts over 76 ms, 12 ms old, on a fixed
grid of 4 ms: it lags the encoder by 52 ms, stretches a 72 ms fall to about 94 ms and, truncated towards
zero, reads half a count low, as the authors' recordings show. It does not depend on when it is read.
"""

from __future__ import annotations

import numpy as np

from hil.config.xh430 import A_PER_COUNT, RAD_PER_COUNT, RAD_S_PER_COUNT
from hil.fakes.plant_api import Plant
from hil.vocabulary.geometry import Array

GRID_NS = 4_000_000
_GRID_S = GRID_NS * 1e-9
_OLD, _SPAN = 3, 19
_ROWS = 128
_DITHER_COUNTS = 0.25
_COUNTS_PER_RAD = 1.0 / RAD_PER_COUNT
_VELOCITY_GAIN = RAD_PER_COUNT / (_SPAN * _GRID_S * RAD_S_PER_COUNT)
HISTORY_NS = (_ROWS - _OLD - _SPAN - 1) * GRID_NS

STALL_OHM, BACK_EMF = 9.23, 2.12


class Sensing:
    """Encoder history of all eight joints, in counts of the joint's own direction from joint angle 0.

    Attributes:
        ticks: samples of the grid taken so far.
    """

    def __init__(self, plant: Plant, rng: np.random.Generator) -> None:
        self._plant, self._rng = plant, rng
        self._history = np.zeros((_ROWS, 8))
        self._history[:] = np.rint(plant.joints()[0] * _COUNTS_PER_RAD)
        self._dither = rng.normal(0.0, _DITHER_COUNTS, (_ROWS, 8))
        self._row = self.ticks = 0

    def tick(self) -> None:
        """Take one sample of the grid."""
        self.ticks += 1
        row = self._row = (self._row + 1) % _ROWS
        if row == 0:
            self._dither = self._rng.normal(0.0, _DITHER_COUNTS, (_ROWS, 8))
        self._history[row] = np.rint(self._plant.joints()[0] * _COUNTS_PER_RAD + self._dither[row])

    def counts(self, age_ns: int = 0) -> list[int]:
        """Encoder counts now (live), or as they were on the grid `age_ns` ago."""
        if age_ns:
            row = self._history[(self._row - min(age_ns, HISTORY_NS) // GRID_NS) % _ROWS]
        else:
            row = np.rint(self._plant.joints()[0] * _COUNTS_PER_RAD + self._dither[self._row])
        return row.astype(np.int64).tolist()  # type: ignore[no-any-return]

    def velocity(self, age_ns: int = 0) -> list[int]:
        """Present Velocity in its counts, truncated towards zero."""
        newest = self._row - _OLD - min(age_ns, HISTORY_NS) // GRID_NS
        moved = self._history[newest % _ROWS] - self._history[(newest - _SPAN) % _ROWS]
        return np.trunc(moved * _VELOCITY_GAIN).astype(np.int64).tolist()  # type: ignore[no-any-return]

    def current(self) -> list[int]:
        """Present Current in its counts."""
        return np.trunc(self._plant.joints()[2] * (1.0 / A_PER_COUNT)).astype(np.int64).tolist()  # type: ignore[no-any-return]

    def currents_a(self) -> Array:
        """True motor currents, A."""
        return self._plant.joints()[2]

    def duty(self, voltage_v: float) -> Array:
        """Duty cycle that the motors are driven with, -1..1 (stall and no-load rows of the data sheet)."""
        _, velocity, current = self._plant.joints()
        return np.clip((current * STALL_OHM + velocity * BACK_EMF) / voltage_v, -1.0, 1.0)
