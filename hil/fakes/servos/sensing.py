"""What the eight servos measure: encoder counts with dither, and the lagging, truncated velocity.

The firmware's velocity is modelled as a difference of encoder counts over 76 ms, 12 ms old, on a fixed
grid of 4 ms: it lags the encoder by 52 ms, stretches a 72 ms fall to about 94 ms and, truncated towards
zero, reads half a count low, as the authors' recordings show. It does not depend on when it is read.
"""

from __future__ import annotations

import numpy as np

from hil.config.servo_models import ServoModel
from hil.core.geometry import Array
from hil.core.named_records import Ints
from hil.fakes.body_interface import Plant
from hil.fakes.servos.encoder_counts import ANGLES, CURRENTS, OLD, PER_RAD, PER_SPAN, SHOWN_COUNTS, SPAN, show
from hil.support.numba_jit import compile_for

GRID_NS = 4_000_000
_GRID_S = GRID_NS * 1e-9
_ROWS = 128
_DITHER_COUNTS = 0.25
HISTORY_NS = (_ROWS - OLD - SPAN - 1) * GRID_NS


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
        span_s = SPAN * _GRID_S
        self.resistance_ohm: Array = np.array([m.motor.resistance_ohm for m in models])
        self._back_emf_v_s_rad: Array = np.array([m.motor.back_emf_v_s_rad for m in models])
        scales = [
            (1.0 / m.rad_per_count, m.rad_per_count / (span_s * m.rad_s_per_count), 1.0 / m.a_per_count)
            for m in models
        ]
        self._scales = np.array(scales).T.copy()
        self._draw()
        at_rest = [float(round(a * s[PER_RAD])) for a, s in zip(plant.joints()[0], scales, strict=True)]
        self._history = np.tile(at_rest, (_ROWS, 1))
        self._row = self.ticks = 0
        self._raw_from = 1
        self._now, self._shown = np.zeros((2, 8)), np.zeros((3, 8), dtype=np.int64)
        compile_for(show, self._now, self._history, self._dither, self._scales, 0, 0, self._shown)

    def _draw(self) -> None:
        """Dither of the next samples of the grid, counts."""
        self._dither = self._rng.normal(0.0, _DITHER_COUNTS, (_ROWS, 8))

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
        """Make counts of the angles in the history from `_raw_from` on, and of those now."""
        row, (angles, _, amps) = self._row, self._plant.joints()
        self._now[ANGLES], self._now[CURRENTS] = angles, amps
        show(self._now, self._history, self._dither, self._scales, self._raw_from, row, self._shown)
        self._raw_from = row + 1

    def measure(self) -> Ints:
        """`counts` and `velocity` now, and Present Current in its counts: (3, 8), until the next call."""
        self._count()
        return self._shown

    def counts(self, age_ns: int = 0) -> list[int]:
        """Encoder counts now (live), or as they were on the grid `age_ns` ago."""
        if not age_ns:
            self._count()
            return [int(n) for n in self._shown[SHOWN_COUNTS]]
        self._count()
        return [int(n) for n in self._history[(self._row - min(age_ns, HISTORY_NS) // GRID_NS) % _ROWS]]

    def velocity(self, age_ns: int = 0) -> list[int]:
        """Present Velocity in its counts, truncated towards zero."""
        self._count()
        row = self._row - OLD - min(age_ns, HISTORY_NS) // GRID_NS
        newer, older = self._history[row % _ROWS], self._history[(row - SPAN) % _ROWS]
        gains = self._scales[PER_SPAN]
        return [int((a - b) * gain) for a, b, gain in zip(newer, older, gains, strict=True)]

    def currents_a(self) -> Array:
        """True motor currents (8,), A."""
        return self._plant.joints()[2]

    def duty(self, voltage_v: float) -> Array:
        """Duty cycle (8,) of the motors, -1..1, by the stall and no-load rows of the data sheet."""
        _, velocity, current = self._plant.joints()
        return np.clip(
            (current * self.resistance_ohm + velocity * self._back_emf_v_s_rad) / voltage_v, -1.0, 1.0
        )
