"""Errors of the angles that encoders of servos measure: ripple and wander of drives, dither of the steering.

All of them are off by default. The ripple repeats with every turn of a wheel; in the authors' recordings its
first order is 1 to 6 counts. Wander and dither change only while the wheel of their module turns.
"""

from itertools import zip_longest

import numpy as np

from hil.config.servo_models import ServoModel
from hil.core.geometry import Array
from hil.fakes.servos.dynamixel.true_parameters import ServoBusOptions
from hil.fakes.smooth_noise import SmoothNoise

_TURNS_RAD_S = 0.02
_DRIVES = 4


class AngleErrors:
    """Angles as the encoders see them, before noise and rounding.

    Args:
        options: true imperfections.
        models: models of the eight servos.
        rng: random stream of wander and dither.
        step_s: time between two calls of `step`.
    """

    def __init__(
        self,
        options: ServoBusOptions,
        models: tuple[ServoModel, ...],
        rng: np.random.Generator,
        step_s: float,
    ) -> None:
        per_count = np.array([model.rad_per_count for model in models])
        orders = max(len(row) for row in options.ripple_counts)
        self._amplitude_rad = _table(options.ripple_counts, orders) * per_count[:_DRIVES, np.newaxis]
        self._phase_rad = _table(options.ripple_phase_rad, orders)
        self._order = np.arange(1.0, orders + 1.0)
        self._wander = SmoothNoise(rng, _DRIVES, options.wander_s, step_s)
        self._dither = SmoothNoise(rng, _DRIVES, options.steer_dither_s, step_s)
        self._wander_rad = options.wander_counts * per_count[:_DRIVES]
        self._dither_rad = options.steer_dither_counts * per_count[_DRIVES:]

    @staticmethod
    def given(options: ServoBusOptions) -> bool:
        """Whether there are any."""
        of_drives = options.wander_counts or any(any(row) for row in options.ripple_counts)
        return bool(of_drives or options.steer_dither_counts)

    def step(self, rates_rad_s: Array) -> None:
        """Go on by one step, with the true rates (8,) of the joints."""
        turns = np.abs(rates_rad_s[:_DRIVES]) > _TURNS_RAD_S
        self._wander.step(turns)
        self._dither.step(turns)

    def seen(self, angles_rad: Array) -> Array:
        """Angles (8,), rad, that the encoders see at true joint angles (8,), rad."""
        turned = angles_rad[:_DRIVES, np.newaxis] * self._order + self._phase_rad
        ripple = np.sum(self._amplitude_rad * np.sin(turned), axis=1)
        of_drives = ripple + self._wander_rad * self._wander.values
        seen: Array = angles_rad + np.concatenate([of_drives, self._dither_rad * self._dither.values])
        return seen


def _table(rows: tuple[tuple[float, ...], ...], orders: int) -> Array:
    """Values (4, orders) by drive and order; zero where a row ends early, cut where it is longer."""
    columns = zip_longest(range(orders), *rows, fillvalue=0.0)
    return np.array([column[1:] for column in columns][:orders], dtype=np.float64).reshape(orders, _DRIVES).T
