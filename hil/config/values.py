"""Types of values that several tables of the bench file share."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import AfterValidator

Quaternion = tuple[float, float, float, float]


def _unit(value: Quaternion) -> Quaternion:
    norm = math.sqrt(sum(v * v for v in value))
    if not 0.99 < norm < 1.01:
        raise ValueError(f"the quaternion (w, x, y, z) has norm {norm:.3g}, not 1")
    w, x, y, z = value
    return (w / norm, x / norm, y / norm, z / norm)


UnitQuaternion = Annotated[Quaternion, AfterValidator(_unit)]
"""(w, x, y, z) within 1 % of unit norm; normalised."""
