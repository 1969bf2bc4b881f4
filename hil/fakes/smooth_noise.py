"""Random errors that change smoothly: their values at neighbouring times are alike."""

import math

import numpy as np

from hil.core.geometry import Array, Bools


class SmoothNoise:
    """Independent random values with standard deviation 1, as white noise after two equal low passes.

    Values that are a time t apart are correlated by (1 + t / T) exp(-t / T). Steps of any length are exact:
    they draw value and slope from their joint distribution.

    Args:
        rng: random stream.
        size: number of values.
        constant_s: time constant T; 0 for values that do not depend on those before.
        step_s: time step.
    """

    def __init__(self, rng: np.random.Generator, size: int, constant_s: float, step_s: float) -> None:
        self._rng = rng
        self._state: Array = rng.standard_normal((2, size))
        x = step_s / constant_s if constant_s > 0.0 else math.inf
        self._kept: Array = np.zeros((2, 2))
        self._drawn: Array = np.eye(2)
        if math.isfinite(x):
            self._kept = np.asarray(math.exp(-x) * np.array([[1.0 + x, x], [-x, 1.0 - x]]), dtype=np.float64)
            covariance: Array = np.eye(2) - self._kept @ self._kept.T
            self._drawn = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)

    @property
    def values(self) -> Array:
        """Present values (size,)."""
        values: Array = self._state[0]
        return values

    def step(self, of: Bools | None = None) -> Array:
        """Return the values (size,) one step later.

        Args:
            of: mask (size,) of the values that go on; the others stay.
        """
        after = self._kept @ self._state + self._drawn @ self._rng.standard_normal(self._state.shape)
        self._state = after if of is None else np.where(of, after, self._state)
        return self.values
