"""Finds the unit of a column by its factor: wheels against ground truth, wheel rates against wheel angles.

In stretches of half a second the way of each wheel is computed from its angle, from the ground truth, and
from its rate. Slip, noise and tolerances change such a way by tenths, or in single stretches. Another unit
changes it by 6 times or more, in all stretches. Raw columns are converted before they are unwrapped, so that
a counter that wraps at its own whole turn is handled as well.
"""

from dataclasses import dataclass, replace

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array
from hil.datasets.nominal_robot import Nominal
from hil.datasets.wheel_ways import Drive, by_truth, by_wheels, missed, rolling
from hil.robot.kinematics import WheelGeometry

_STRETCH_S = 0.5
_ROLLING = 0.2
_WORTH_M = 0.1
_OWN = 0.3
_MOST = 0.7
_WRONG, _RIGHT, _HEADING = float(np.log(2.5)), float(np.log(1.5)), float(np.log(1.15))
_AGREES, _OFF, _WITHIN_RAD = 0.2, 0.1, 2.2 * np.pi
_FEWEST = 3
_SLOWEST_RAD_S = 0.2
_DISAGREE, _SAME_UNIT = float(np.log(2.0)), 0.2
_SCALED, _STEADY = float(np.log(1.2)), float(np.log(1.1))
"""Least factor of rates that is named where it is steady, and by how much a steady factor varies."""
_STILL_RAD, _STILL_STRETCHES, _CAUGHT_UP = 0.01, 2, 0.5


@dataclass(frozen=True)
class _Unit:
    """A wrong unit that a column may be in; `to_si` is the factor that converts its numbers."""

    column: str
    name: str
    to_si: float

    @property
    def truth(self) -> tuple[float, float]:
        """Factors on positions and headings that convert the ground truth."""
        return (self.to_si if self.column == "x, y" else 1.0, self.to_si if self.column == "theta" else 1.0)

    @property
    def alone(self) -> tuple[float, float]:
        """Factors that keep only the converted columns: a column that adds little cannot be the cause."""
        return (self.to_si, 0.0) if self.column == "x, y" else (0.0, self.to_si)


_WAYS = (
    _Unit("phi", "revolutions", 2.0 * np.pi),
    _Unit("phi", "degrees", np.pi / 180.0),
    _Unit("phi", "steps of 4096 a turn", 2.0 * np.pi / 4096.0),
    _Unit("x, y", "millimetres", 1e-3),
    _Unit("x, y", "centimetres", 1e-2),
    _Unit("x, y", "inches", 0.0254),
    _Unit("theta", "degrees", np.pi / 180.0),
    _Unit("theta", "revolutions", 2.0 * np.pi),
)
_OF_ANGLES = 3
"""Number of units of wheel angles, the first ones."""
_STEERING = (
    _Unit("delta", "degrees", np.pi / 180.0),
    _Unit("delta", "gradians", np.pi / 200.0),
    _Unit("delta", "revolutions", 2.0 * np.pi),
    _Unit("delta", "steps of 4096 a turn", 2.0 * np.pi / 4096.0),
)
_RATES = (
    _Unit("w", "revolutions per minute", 2.0 * np.pi / 60.0),
    _Unit("w", "revolutions per second", 2.0 * np.pi),
    _Unit("w", "degrees per second", np.pi / 180.0),
    _Unit("w", "steps of 0.229 revolutions per minute", 0.229 * 2.0 * np.pi / 60.0),
)
_SI = {
    "phi": ("wheel angles (phi) seem", "rad"),
    "w": ("wheel rates (w), of which the wheel angles were integrated, seem", "rad/s"),
    "x, y": ("positions (x, y) seem", "m"),
    "theta": ("the heading (theta) seems", "rad"),
}


def check_ways(where: str, drive: Drive, nominal: Nominal, *, integrated: bool = False) -> None:
    """Refuse a column in another unit: the ways differ by far as they are, and agree once it is converted.

    Unconverted, wheels and ground truth differ by 2.5 times or more in seven tenths of the stretches in which
    wheels roll; converted, by less than 1.5 times in as many. A single slide, spin or jump does not decide.
    If converting a column that adds little to the way also makes the ways agree, nothing is refused. An
    example are positions in turns on the spot, where the marker is far from the middle of the robot.
    A heading is named only if its factor is that of the unit within 15 %, and translations agree as they are.

    Args:
        where: the file, for messages.
        drive: the recording before any unwrapping.
        nominal: robot with the wheels.
        integrated: True where the wheel angles were integrated from wheel rates.

    Raises:
        DataError: names column, unit and factor.
    """
    start_s, end_s = max(drive.t_s[0], drive.truth_t_s[0]), min(drive.t_s[-1], drive.truth_t_s[-1])
    edges_s, wheels = np.arange(start_s, end_s, _STRETCH_S), nominal.geometry
    rolled, moved = _rolled(drive, edges_s, wheels), _moved(drive, edges_s, wheels)
    if _share(rolled, moved, _WRONG) > 1.0 - _MOST:
        return
    fits = []
    same_way = _translations_agree(drive, edges_s, wheels)
    for unit in (*_RATES, *_WAYS[_OF_ANGLES:]) if integrated else _WAYS:
        way, true = rolled, _moved(drive, edges_s, wheels, *unit.truth)
        of_wheels = unit.column in ("phi", "w")
        if of_wheels:
            way = _rolled(drive, edges_s, wheels, unit.to_si)
        if min(way.sum(), true.sum()) < _WORTH_M or _share(way, true, _RIGHT) < _MOST:
            continue
        if not of_wheels and _moved(drive, edges_s, wheels, *unit.alone).sum() < _OWN * way.sum():
            return
        off = float(np.median(_logs(way, true)))
        if unit.column == "theta" and not (same_way and off < _HEADING):
            continue
        fits.append((off, unit))
    if not fits:
        return
    unit = min(fits, key=lambda fit: fit[0])[1]
    label, si = _SI[unit.column]
    near = " or gradians" if unit.name == "degrees" else ""
    factor = f"{unit.to_si:.6g}" + (f" (gradians: {np.pi / 200.0:.6g})" if near else "")
    other_robot = (
        f"; or, where it is in {si}, name the robot's bench file with --bench: here wheels have a radius of "
        f"{1e3 * nominal.radius_m:.3g} mm ({nominal.source})"
    )
    raise DataError(
        where,
        f"{label} to be in {unit.name}{near}: wheels rolled {rolled.sum():.3g} m but ground truth moved "
        f"{moved.sum():.3g} m, and both agree once {unit.column} is converted",
        expected=f"{unit.column} in {si}",
        remedy=f"multiply {unit.column} by {factor}{other_robot if unit.column in ('phi', 'w') else ''}",
    )


def _translations_agree(drive: Drive, edges_s: Array, wheels: WheelGeometry) -> bool:
    """Whether ways of the middle of the wheels agree, whatever the heading; True where it hardly moves."""
    unwrapped = replace(drive, angle=np.unwrap(drive.angle, axis=0))
    middle = np.abs(by_wheels(unwrapped, edges_s, wheels).mean(axis=1))
    moved = np.abs(by_truth(drive.truth_t_s, drive.pose * (1.0, 1.0, 0.0), edges_s, wheels).mean(axis=1))
    return min(middle.sum(), moved.sum()) < _WORTH_M or _share(middle, moved, _WRONG) > 1.0 - _MOST


def check_steering_unit(where: str, drive: Drive, raw: Array, nominal: Nominal) -> None:
    """Refuse steering angles in another unit: converted, the wheels agree with the ground truth.

    Converted, each wheel misses less than 0.2 of its way from stretch to stretch, and less than half as much
    as the worst does now; two or more are off now (a single one may be mounted half a turn round). Degrees
    and steps are beyond a whole turn of radians, and within 1.1 turns of their own. The size alone says
    nothing: absolute encoders count from 0 to a whole turn, and some count turns.

    Args:
        where: the file, for messages.
        drive: recording with unwrapped angles and heading.
        raw: (n, 4) steering angles as in the file.
        nominal: robot with the wheels.

    Raises:
        DataError: names unit and factor.
    """
    edges_s, wheels = drive.edges_s(), nominal.geometry
    moved = by_truth(drive.truth_t_s, drive.pose, edges_s, wheels)
    rolled = by_wheels(drive, edges_s, wheels)
    mask = rolling(rolled, moved, drive.known(edges_s), wheels)
    before = missed(rolled[mask], moved[mask])
    if np.count_nonzero(before > _OFF) < 2:
        return
    size, fits = float(np.max(np.abs(raw))), list[tuple[float, _Unit]]()
    for unit in _STEERING:
        if size * unit.to_si > _WITHIN_RAD or (unit.to_si < 1.0 and size < 2.0 * np.pi):
            continue
        way = by_wheels(replace(drive, steering=raw * unit.to_si), edges_s, wheels)
        after = float(np.max(missed(way[mask], moved[mask])))
        if after < min(_AGREES, 0.5 * float(np.max(before))):
            fits.append((after, unit))
    if fits:
        unit = min(fits, key=lambda fit: fit[0])[1]
        raise DataError(
            where,
            f"steering angles (delta) seem to be in {unit.name}: a wheel misses {100.0 * np.max(before):.0f} "
            "% of its way by ground truth, and all agree once they are converted",
            expected="delta in rad",
            remedy=f"multiply delta by {unit.to_si:.6g}",
        )


def _rolled(drive: Drive, edges_s: Array, wheels: WheelGeometry, factor: float = 1.0) -> Array:
    """Way (s,) of the wheels between edges (s + 1,), mean of the four, m, with angles times a factor."""
    angle = np.unwrap(drive.angle * factor, axis=0)
    turned = np.diff([np.interp(edges_s, drive.t_s, column) for column in angle.T])
    return np.asarray(np.mean(np.abs(turned) * wheels.radius_m[:, None], axis=0), dtype=np.float64)


def _moved(
    drive: Drive, edges_s: Array, wheels: WheelGeometry, position: float = 1.0, heading: float = 1.0
) -> Array:
    """Way (s,) of the wheels by ground truth, mean of the four, m, with poses times two factors."""
    pose = drive.pose * (position, position, heading)
    pose[:, 2] = np.unwrap(pose[:, 2])
    ways = np.abs(by_truth(drive.truth_t_s, pose, edges_s, wheels))
    return np.asarray(ways.mean(axis=1), dtype=np.float64)


def _logs(rolled: Array, moved: Array) -> Array:
    """Absolute log ratios of two ways (s,), in the stretches in which the wheels clearly roll."""
    if not len(rolled) or not rolled.any():
        return np.empty(0)
    rolls = rolled > _ROLLING * np.percentile(rolled, 90.0)
    return np.asarray(np.abs(np.log(np.maximum(moved[rolls], 1e-12) / rolled[rolls])), dtype=np.float64)


def _share(rolled: Array, moved: Array, within: float) -> float:
    """Share of the stretches whose ways agree within a log ratio; 1 where there are too few stretches."""
    logs = _logs(rolled, moved)
    return float(np.mean(logs < within)) if len(logs) >= _FEWEST else 1.0


def check_rates(where: str, t_s: Array, angle: Array, rate: Array) -> None:
    """Refuse wheel rates that are not the time derivative of the wheel angles, in rad/s.

    A wheel counts if it turns at 0.2 rad/s or more, by angle or rate, in at least three stretches: a register
    that counts in steps is inaccurate at lower speeds. It disagrees if seven tenths of them are off by a
    factor of two or more, or have the opposite sign, or if as many are off by one factor, from 1.2 on. If all
    wheels have the opposite sign, `hil.datasets.wrong_signs` reports it. An angle that stands still for a
    second while its rate goes on is a stuck encoder.

    Args:
        where: the file, for messages.
        t_s: (n,) times, s, increasing.
        angle: (n, 4) wheel angles, rad, unwrapped.
        rate: (n, 4) wheel rates; not checked if one is not finite.

    Raises:
        DataError: names the columns, and the unit where the factor shows it.
    """
    if not np.all(np.isfinite(rate)):
        return
    edges_s = np.arange(t_s[0], t_s[-1], _STRETCH_S)
    way = np.vstack([np.zeros(4), np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t_s)[:, None], axis=0)])
    pairs = (np.diff([np.interp(edges_s, t_s, c) for c in columns.T]) for columns in (angle, way))
    turns = list(zip(*pairs, strict=True))
    for i, (by_angle, by_rate) in enumerate(turns):
        _check_stuck(where, i, by_angle, by_rate)
    ratios = [_ratios(by_angle, by_rate) for by_angle, by_rate in turns]
    counted = [r for r in ratios if len(r)]
    if counted and all(np.median(r) < 0.0 for r in counted):
        return
    wrong = [i for i, r in enumerate(ratios) if len(r) and (np.mean(_agrees(r)) <= 1.0 - _MOST or _scaled(r))]
    if not wrong:
        return
    factor = float(np.median(np.concatenate([ratios[i] for i in wrong])))
    names = ", ".join(f"w{i + 1}" for i in wrong)
    unit = _rate_unit(factor)
    if unit is None:
        raise DataError(
            where,
            f"wheel rates ({names}) disagree with the wheel angles (phi): {factor:.3g} times the rate at "
            "which those grow",
            expected="w in rad/s, the rate at which phi grows",
            remedy="correct the columns, or leave out w1 to w4, which only the signal velocity needs",
        )
    raise DataError(
        where,
        f"wheel rates ({names}) seem to be in {unit.name}: {factor:.3g} times the rates of the angles (phi)",
        expected="w in rad/s",
        remedy=f"multiply w by {unit.to_si:.6g}",
    )


def _check_stuck(where: str, wheel: int, by_angle: Array, by_rate: Array) -> None:
    """Refuse an angle that stands still while its rate says that the wheel rolls, and does not catch up.

    Args:
        where: the file, for messages.
        wheel: index of the wheel.
        by_angle: (s,) turn by the angle in each stretch, rad.
        by_rate: (s,) turn by the rate, rad.

    Raises:
        DataError: names the column, and when it stands still.
    """
    stuck = (np.abs(by_angle) < _STILL_RAD) & (np.abs(by_rate) > _SLOWEST_RAD_S * _STRETCH_S)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], stuck, [False]]).astype(np.int8)))
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        rolled = float(by_rate[begin:end].sum())
        caught_up = float(by_angle[begin : end + 1].sum()) / rolled > _CAUGHT_UP
        if end - begin < _STILL_STRETCHES or caught_up:
            continue
        raise DataError(
            where,
            f"phi{wheel + 1} stands still while w{wheel + 1} rolls: by {abs(rolled):.2g} rad in the "
            f"{_STRETCH_S * (end - begin):.1f} s from {_STRETCH_S * begin:.1f} s after its begin",
            expected="w in rad/s, the rate at which phi grows",
            remedy="look for a stuck encoder; leave the recording out, cut it there, or, where the wheel did "
            "stand, leave out w1 to w4",
        )


def _scaled(ratio: Array) -> bool:
    """Whether ratios (s,) are of one factor, 1.2 or more, but for three tenths of them."""
    off = np.log(np.maximum(ratio, 1e-12))
    middle = float(np.median(off))
    return abs(middle) > _SCALED and bool(np.mean(np.abs(off - middle) < _STEADY) >= _MOST)


def _ratios(by_angle: Array, by_rate: Array) -> Array:
    """Turn of one wheel by rate over turn by angle, per stretch; empty where too few stretches count."""
    turns = np.maximum(np.abs(by_angle), np.abs(by_rate)) > _SLOWEST_RAD_S * _STRETCH_S
    if np.count_nonzero(turns) < _FEWEST:
        return np.empty(0)
    nonzero = np.where(np.abs(by_angle) < 1e-9, 1e-9, by_angle)
    return np.asarray(by_rate[turns] / nonzero[turns], dtype=np.float64)


def _agrees(ratio: Array) -> Array:
    return np.asarray(np.abs(np.log(np.maximum(ratio, 1e-12))) < _DISAGREE)


def _rate_unit(factor: float) -> _Unit | None:
    """Unit whose numbers are `factor` times rad/s; None where no unit is near."""
    if factor <= 0.0:
        return None
    off, unit = min(((abs(np.log(factor * unit.to_si)), unit) for unit in _RATES), key=lambda found: found[0])
    return unit if off < _SAME_UNIT else None
