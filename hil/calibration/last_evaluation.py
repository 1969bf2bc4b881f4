"""Keeps costs and terms of the parameters that a fit evaluated last, so that none is computed twice."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from hil.core.geometry import Array

Terms: TypeAlias = tuple[Array, Array, Array]
"""Of each recording: cost (R,), J'e (R, m) and J'J (R, m, m)."""


class Known:
    """Costs and terms of the last parameters, and memory for them; shared where only weights differ."""

    def __init__(self) -> None:
        self._costs: tuple[Array, Array] | None = None
        self._terms: tuple[Array, Terms] | None = None
        self._rows: tuple[Array, Array] | None = None

    def under_another_law(self) -> Known:
        """Nothing known, in the same memory."""
        other = Known()
        other._rows = self._rows
        return other

    def keep_costs(self, z: Array, costs: Array) -> None:
        """Costs (R,) of parameters z (m,)."""
        self._costs = z.copy(), costs

    def keep_terms(self, z: Array, terms: Terms) -> None:
        """Terms of parameters z (m,)."""
        self._terms = z.copy(), terms

    def costs(self, z: Array) -> Array | None:
        """Costs (R,) of parameters z (m,), if they are the last ones that costs or terms were asked of."""
        terms = self.terms(z)
        if terms is not None:
            return terms[0]
        return self._costs[1] if self._costs is not None and np.array_equal(self._costs[0], z) else None

    def terms(self, z: Array) -> Terms | None:
        """Terms of parameters z (m,), if they are the last ones that terms were asked of."""
        return self._terms[1] if self._terms is not None and np.array_equal(self._terms[0], z) else None

    def rows(self, shape: tuple[int, ...], size: int) -> tuple[Array, Array]:
        """Room for errors (R, N, 3) and slopes (R, N, 3, m), 0 where nothing was put yet."""
        if self._rows is None:
            self._rows = np.zeros(shape), np.zeros((*shape, size))
        return self._rows
