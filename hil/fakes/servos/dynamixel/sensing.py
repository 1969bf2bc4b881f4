"""Measurements of the eight servos: encoder counts with dither, and the lagging, truncated velocity.

The firmware's velocity is modelled as a difference of encoder counts over 76 ms, 12 ms old, on a fixed grid
of 4 ms: it lags the encoder by 52 ms, stretches a 72 ms fall to about 94 ms and, truncated towards zero,
reads half a count low, as in the authors' recordings. It does not depend on the time of the read.
"""

import numpy as np

from hil.config.servo_models import ServoModel
from hil.core.geometry import Array
from hil.core.named_records import Ints
from hil.fakes.body_interface import Plant
from hil.fakes.servos.dynamixel.angle_errors import AngleErrors
from hil.support.numba_jit import compile_for, inner, kernel

# Rows of the scales (3, 8): counts per rad, velocity counts per count of a span, counts per A.
PER_RAD, PER_SPAN, PER_A = range(3)

# Rows of the present measurement (2, 8): angles in rad and currents in A.
ANGLES, CURRENTS = range(2)

# Rows of the register values (3, 8): encoders, velocities and currents.
SHOWN_COUNTS, SHOWN_VELOCITIES, SHOWN_CURRENTS = range(3)

OLD, SPAN = 3, 19
"""Age of the firmware's velocity, and its time span, in points of the grid."""


@inner
def count(history: Array, dither: Array, scales: Array, first: int, last: int) -> None:
    """Convert the angles in the history to counts.

    Args:
        history: history (n, 8); updated.
        dither: (n, 8) counts.
        scales: scales (3, 8) with the rows `PER_RAD`, `PER_SPAN`, `PER_A`.
        first: first row that holds angles.
        last: last row that holds angles; none does if it is before `first`.
    """
    per_rad = scales[PER_RAD]
    for row in range(first, last + 1):
        values, added = history[row], dither[row]
        for j in range(8):
            values[j] = float(round(values[j] * per_rad[j] + added[j]))


@kernel
def show(
    now: Array, history: Array, fine: Array, dither: Array, scales: Array, first: int, row: int, shown: Ints
) -> None:
    """Convert to encoder, velocity and current counts of the servos; the last two truncate towards zero.

    Args:
        now: (2, 8) present angles and currents.
        history: history (n, 8); updated.
        fine: history (n, 8) of which the velocity is computed, counts: `history`, or its angles not rounded.
        dither: (n, 8) counts.
        scales: scales (3, 8) with the rows `PER_RAD`, `PER_SPAN`, `PER_A`.
        first: first row of the history that holds angles.
        row: row of the latest grid point.
        shown: result: (3, 8) integers.
    """
    count(history, dither, scales, first, row)
    angles, amps, added = now[ANGLES], now[CURRENTS], dither[row]
    newer, older = fine[row - OLD], fine[row - OLD - SPAN]
    counts, velocities, currents = shown[SHOWN_COUNTS], shown[SHOWN_VELOCITIES], shown[SHOWN_CURRENTS]
    per_rad, per_span, per_a = scales[PER_RAD], scales[PER_SPAN], scales[PER_A]
    for j in range(8):
        counts[j] = round(angles[j] * per_rad[j] + added[j])
        velocities[j] = int((newer[j] - older[j]) * per_span[j])
        currents[j] = int(amps[j] * per_a[j])


GRID_NS = 4_000_000
_GRID_S = GRID_NS * 1e-9
_ROWS = 128
HISTORY_NS = (_ROWS - OLD - SPAN - 1) * GRID_NS


class Sensing:
    """Encoder history of all eight joints, in counts of the joint's own direction from joint angle 0.

    Args:
        plant: source of angles, rates and currents.
        rng: random numbers of the dither.
        models: models of the eight servos, with their units and motors.
        dither_counts: noise of the encoders before rounding, one sigma.
        errors: errors of the angles; None without.
        of_angle: True if the velocity is computed of the angles before noise and rounding.

    Attributes:
        resistance_ohm: resistances (8,) of the motors.
        ticks: number of grid samples taken so far.
    """

    def __init__(
        self,
        plant: Plant,
        rng: np.random.Generator,
        models: tuple[ServoModel, ...],
        dither_counts: float = 0.25,
        errors: AngleErrors | None = None,
        *,
        of_angle: bool = False,
    ) -> None:
        self._plant, self._rng, self._dither_counts = plant, rng, dither_counts
        self._errors = errors
        span_s = SPAN * _GRID_S
        self.resistance_ohm: Array = np.array([m.motor.resistance_ohm for m in models])
        self._back_emf_v_s_rad: Array = np.array([m.motor.back_emf_v_s_rad for m in models])
        scales = [
            (1.0 / m.rad_per_count, m.rad_per_count / (span_s * m.rad_s_per_count), 1.0 / m.a_per_count)
            for m in models
        ]
        self._scales = np.array(scales).T.copy()
        self._draw()
        at_rest = [float(round(a * s[PER_RAD])) for a, s in zip(self._angles(), scales, strict=True)]
        self._history = np.tile(at_rest, (_ROWS, 1))
        self._fine = self._history
        if of_angle:
            self._fine = np.tile(self._angles() * self._scales[PER_RAD], (_ROWS, 1))
        self._row = self.ticks = 0
        self._raw_from = 1
        self._now, self._shown = np.zeros((2, 8)), np.zeros((3, 8), dtype=np.int64)
        compile_for(show, self._now, self._history, self._fine, self._dither, self._scales, 0, 0, self._shown)

    def _angles(self) -> Array:
        """Present angles (8,) as the encoders see them, rad."""
        angles = self._plant.joints()[0]
        return angles if self._errors is None else self._errors.seen(angles)

    def _draw(self) -> None:
        """Draw the dither of the next grid samples, counts."""
        self._dither = self._rng.normal(0.0, self._dither_counts, (_ROWS, 8))

    def tick(self) -> None:
        """Take one grid sample of the angles; they are converted to counts when they are read."""
        self.ticks += 1
        row = self._row + 1
        if row == _ROWS:
            self._count()
            self._draw()
            row = self._raw_from = 0
        self._row = row
        if self._errors is not None:
            self._errors.step(self._plant.joints()[1])
        self._history[row] = angles = self._angles()
        if self._fine is not self._history:
            self._fine[row] = angles * self._scales[PER_RAD]

    def _count(self) -> None:
        """Convert the angles in the history from `_raw_from` on, and the present ones, to counts."""
        row, amps = self._row, self._plant.joints()[2]
        self._now[ANGLES], self._now[CURRENTS] = self._angles(), amps
        first, fine = self._raw_from, self._fine
        show(self._now, self._history, fine, self._dither, self._scales, first, row, self._shown)
        self._raw_from = row + 1

    def measure(self) -> Ints:
        """Return present encoder, velocity and current counts, (3, 8); valid until the next call."""
        self._count()
        return self._shown

    def counts(self, age_ns: int = 0) -> list[int]:
        """Return the present encoder counts, or those `age_ns` before the newest sample of the grid.

        Between two samples they are linear: values of some time ago move as smoothly as present ones.
        """
        self._count()
        if not age_ns:
            return [int(n) for n in self._shown[SHOWN_COUNTS]]
        rows, rest_ns = divmod(min(age_ns, HISTORY_NS), GRID_NS)
        row, share = self._row - rows, rest_ns / GRID_NS
        newer, older = self._history[row % _ROWS], self._history[(row - 1) % _ROWS]
        return [round(a + share * (b - a)) for a, b in zip(newer, older, strict=True)]

    def velocity(self, age_ns: int = 0) -> list[int]:
        """Return Present Velocity in its counts, truncated towards zero."""
        self._count()
        row = self._row - OLD - min(age_ns, HISTORY_NS) // GRID_NS
        newer, older = self._fine[row % _ROWS], self._fine[(row - SPAN) % _ROWS]
        gains = self._scales[PER_SPAN]
        return [int((a - b) * gain) for a, b, gain in zip(newer, older, gains, strict=True)]

    def currents_a(self) -> Array:
        """Return the true motor currents (8,), A."""
        return self._plant.joints()[2]

    def duty(self, voltage_v: float) -> Array:
        """Return the motors' duty cycle (8,), -1..1, by the stall and no-load rows of the data sheet."""
        _, velocity, current = self._plant.joints()
        return np.clip(
            (current * self.resistance_ohm + velocity * self._back_emf_v_s_rad) / voltage_v, -1.0, 1.0
        )
