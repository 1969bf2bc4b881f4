"""Wheel parameters of a calibration file, and checks that they are plausible for the nominal robot.

A calibration moves wheels by millimetres. Values far beyond that come from a damaged or mistyped file, and a
robot driven with them goes somewhere else. The limits include any workshop's tolerances and everything that
the bounds of the fit permit.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from pydantic import BaseModel, ConfigDict

from hil.core.geometry import Array

POSITION_M = 0.05
SHARE = 0.2
STEERING_ZERO_RAD = 0.5
TWIST = 1.0
TWIST_RAD_M = 20.0

_ROUNDING = 1.0 + 1e-9
_CENTRED_M = 0.01
_FARTHEST_M = 10.0
_LARGEST_RADIUS_M = 0.5
_STIFFEST = 10.0

Four = tuple[float, float, float, float]
Row = tuple[float, float, float]


class Parameters(BaseModel):
    """Effective wheel parameters, wheel order FL, BL, BR, FR."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    x_w_m: Four
    y_w_m: Four
    r_m: Four
    delta0_rad: Four = (0.0, 0.0, 0.0, 0.0)


class Tyres(BaseModel):
    """Loads and creep ratio for the contact models; see `hil.robot.kinematics.WheelGeometry`."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    load: Four
    creep_ratio: float


def impossible_nominal(paper: Parameters) -> Iterator[str]:
    """Implausible nominal parameters, one message each: dotted key, value, expected range."""
    for name, values in (("x_w_m", paper.x_w_m), ("y_w_m", paper.y_w_m)):
        for i, value in enumerate(values):
            if not abs(value) <= _FARTHEST_M:
                yield f"nominal.{name}.{i}: {value:g} m; expected at most {_FARTHEST_M:g} m from the centre"
    for i, value in enumerate(paper.r_m):
        if not 0.0 < value <= _LARGEST_RADIUS_M:
            yield f"nominal.r_m.{i}: {value:g} m; expected more than 0, at most {_LARGEST_RADIUS_M:g} m"
    yield from _zeros("nominal", paper)


def impossible_wheels(found: Parameters, paper: Parameters) -> Iterator[str]:
    """Parameters too far from the nominal ones, one message each; the nominal ones must be plausible."""
    yield from _positions("x_w_m", found.x_w_m, paper.x_w_m)
    yield from _positions("y_w_m", found.y_w_m, paper.y_w_m)
    for i, (value, nominal) in enumerate(zip(found.r_m, paper.r_m, strict=True)):
        if not abs(value - nominal) <= SHARE * nominal * _ROUNDING:
            yield f"parameters.r_m.{i}: {value:g} m; expected within {SHARE:.0%} of nominal, {nominal:g} m"
    yield from _zeros("parameters", found)


def _positions(name: str, values: Four, papers: Four) -> Iterator[str]:
    limit = max(POSITION_M, SHARE * max(abs(nominal) for nominal in papers))
    for i, (value, nominal) in enumerate(zip(values, papers, strict=True)):
        where = f"parameters.{name}.{i}: {value:g} m"
        if abs(nominal) > _CENTRED_M and value * nominal <= 0.0:
            yield f"{where}; expected on the same side of the robot as nominal, {nominal:g} m"
        elif not abs(value - nominal) <= limit * _ROUNDING:
            yield f"{where}; expected within {1e3 * limit:g} mm of nominal, {nominal:g} m"


def _zeros(table: str, wheels: Parameters) -> Iterator[str]:
    for i, value in enumerate(wheels.delta0_rad):
        if not abs(value) <= STEERING_ZERO_RAD:
            yield f"{table}.delta0_rad.{i}: {value:g} rad; expected within +-{STEERING_ZERO_RAD:g} rad"


def impossible_twist(rows: Sequence[Row]) -> Iterator[str]:
    """Elements of a twist correction (3, 3) too far from the identity, one message each.

    The last row mixes m and rad. Recordings that drive in one direction only leave a column empty, which
    passes.
    """
    for i, row in enumerate(rows):
        for j, value in enumerate(row):
            limit, unit = (TWIST_RAD_M, " rad/m") if i == 2 and j < 2 else (TWIST, "")
            one = float(i == j)
            if not abs(value - one) <= limit * _ROUNDING:
                yield f"twist_correction.{i}.{j}: {value:g}; expected within {limit:g}{unit} of {one:g}"


def impossible_tyres(tyres: Tyres) -> Iterator[str]:
    """Implausible loads, relative to their mean, or creep ratio, one message each."""
    for i, value in enumerate(tyres.load):
        if not 0.0 <= value <= 4.0 * _ROUNDING:
            yield f"tyres.load.{i}: {value:g}; expected 0 to 4 times the mean load"
    if not any(value > 0.0 for value in tyres.load):
        yield "tyres.load: expected a wheel that carries something"
    if not 0.0 < tyres.creep_ratio <= _STIFFEST:
        yield f"tyres.creep_ratio: {tyres.creep_ratio:g}; expected more than 0, at most {_STIFFEST:g}"


def numbers(values: Array) -> object:
    """Values of any shape () or (n, ...) as nested lists, with None for values that are not finite."""
    if values.ndim:
        return [numbers(v) for v in values]
    return float(values) if np.isfinite(values) else None


def named(z: Array) -> dict[str, object]:
    """Parameters (12 or 16,) as a mapping with the keys used in results."""
    keys = ("x_w_m", "y_w_m", "r_m", "delta0_rad")
    return {k: numbers(z[4 * i : 4 * i + 4]) for i, k in enumerate(keys) if len(z) >= 4 * i + 4}
