"""Finds the unit of a column by its factor: wheels against ground truth.

In stretches of half a second the way of each wheel is computed from its angle and from the ground truth.
Slip, noise and tolerances change such a way by tenths, or in single stretches. Another unit changes it by 6
times or more, in all stretches. Raw columns are converted before they are unwrapped, so that a counter that
wraps at its own whole turn is handled as well.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.core.geometry import Array
from hil.datasets.nominal_robot import Nominal
from hil.datasets.wheel_displacements import Drive, by_truth, by_wheels, missed, rolling
from hil.datasets.wrong_units import UnitError
from hil.robot.kinematics import WheelGeometry

_STRETCH_S = 0.5
_ROLLING = 0.2
_WORTH_M = 0.1
_OWN = 0.3
_MOST = 0.7
_WRONG, _RIGHT, _HEADING = float(np.log(2.5)), float(np.log(1.5)), float(np.log(1.15))
_AGREES, _OFF, _WITHIN_RAD = 0.2, 0.1, 2.2 * np.pi
_FEWEST = 3
_LEAPING, _OTHER_WHEELS = 0.05, 5.0


@dataclass(frozen=True)
class Unit:
    """A wrong unit that a column may be in.

    Attributes:
        column: name of the column.
        name: name of the unit.
        to_si: factor that converts its numbers.
    """

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
    Unit("phi", "revolutions", 2.0 * np.pi),
    Unit("phi", "degrees", np.pi / 180.0),
    Unit("phi", "steps of 4096 a turn", 2.0 * np.pi / 4096.0),
    Unit("x, y", "millimetres", 1e-3),
    Unit("x, y", "centimetres", 1e-2),
    Unit("x, y", "inches", 0.0254),
    Unit("theta", "degrees", np.pi / 180.0),
    Unit("theta", "revolutions", 2.0 * np.pi),
)
_OF_ANGLES = 3
"""Number of units of wheel angles, the first ones."""
_STEERING = (
    Unit("delta", "degrees", np.pi / 180.0),
    Unit("delta", "gradians", np.pi / 200.0),
    Unit("delta", "revolutions", 2.0 * np.pi),
    Unit("delta", "steps of 4096 a turn", 2.0 * np.pi / 4096.0),
)
RATES = (
    Unit("w", "revolutions per minute", 2.0 * np.pi / 60.0),
    Unit("w", "revolutions per second", 2.0 * np.pi),
    Unit("w", "degrees per second", np.pi / 180.0),
    Unit("w", "steps of 0.229 revolutions per minute", 0.229 * 2.0 * np.pi / 60.0),
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
    Where no single column explains it, several are converted, as few as do; the first is named, see
    `hil.datasets.wrong_units`. If converting a column that adds little to the way also makes the ways agree,
    nothing is refused. An example are positions in turns on the spot, where the marker is far from the middle
    of the robot. A heading is named only if its factor is that of the unit within 15 %, and translations
    agree without it.

    Args:
        where: the file, for messages.
        drive: the recording before any unwrapping.
        nominal: robot with the wheels.
        integrated: True where the wheel angles were integrated from wheel rates.

    Raises:
        UnitError: names column, unit and factor.
    """
    start_s, end_s = max(drive.t_s[0], drive.truth_t_s[0]), min(drive.t_s[-1], drive.truth_t_s[-1])
    edges_s, wheels = np.arange(start_s, end_s, _STRETCH_S), nominal.geometry
    rolled, moved = _rolled(drive, edges_s, wheels), _moved(drive, edges_s, wheels)
    if _share(rolled, moved, _WRONG) > 1.0 - _MOST and not _leaps(drive.angle):
        return
    units = _explaining(drive, edges_s, wheels, (*RATES, *_WAYS[_OF_ANGLES:]) if integrated else _WAYS)
    if not units:
        return
    unit, columns = units[0], " and ".join(unit.column for unit in units)
    label, si = _SI[unit.column]
    near = " or gradians" if unit.name == "degrees" else ""
    factor = f"{unit.to_si:.6g}" + (f" (gradians: {np.pi / 200.0:.6g})" if near else "")
    other_robot = (
        f"; or, where it is in {si}, name the robot's bench file with --bench: here wheels have a radius of "
        f"{1e3 * nominal.radius_m:.3g} mm ({nominal.source})"
    )
    raise UnitError(
        where,
        f"{label} to be in {unit.name}{near}: wheels rolled {rolled.sum():.3g} m but ground truth moved "
        f"{moved.sum():.3g} m, and both agree once {columns} {'is' if len(units) == 1 else 'are'} converted",
        {unit.column: unit.to_si},
        expected=f"{unit.column} in {si}",
        remedy=f"multiply {unit.column} by {factor}{other_robot if unit.column in ('phi', 'w') else ''}",
    )


def _explaining(drive: Drive, edges_s: Array, wheels: WheelGeometry, of: Sequence[Unit]) -> tuple[Unit, ...]:
    """The fewest wrong units with which all ways agree, at most one of each column; empty where none do.

    Two that nearly cancel are taken for wheels of another size, unless the angles cannot be in radians.
    """
    leaping = _leaps(drive.angle)
    for number in range(1, len({unit.column for unit in of}) + 1):
        fits = list[tuple[float, tuple[Unit, ...]]]()
        for units in itertools.combinations(of, number):
            if len({unit.column for unit in units}) < number:
                continue
            angles, poses = 1.0, np.ones(3)
            for unit in units:
                angles *= unit.to_si if unit.column in ("phi", "w") else 1.0
                poses *= (unit.truth[0], unit.truth[0], unit.truth[1])
            if not leaping and number > 1 and 1.0 / _OTHER_WHEELS < angles / poses[0] < _OTHER_WHEELS:
                continue
            right = replace(drive, angle=drive.angle * angles, pose=drive.pose * poses)
            way, true = _rolled(right, edges_s, wheels), _moved(right, edges_s, wheels)
            if (
                min(way.sum(), true.sum()) < _WORTH_M
                or _share(way, true, _RIGHT) < _MOST
                or _leaps(right.angle)
            ):
                continue
            little = [
                unit
                for unit in units
                if (unit.column == "x, y" or (unit.column == "theta" and number == 1))
                and _moved(drive, edges_s, wheels, *unit.alone).sum() < _OWN * way.sum()
            ]
            if little and number == 1:
                return ()
            if little:
                continue
            off = float(np.median(_logs(way, true)))
            of_heading = any(unit.column == "theta" for unit in units)
            if of_heading and not (
                off < _HEADING and _translations_agree(right, edges_s, wheels, number > 1)
            ):
                continue
            fits.append((off, units))
        if fits:
            return min(fits, key=lambda fit: fit[0])[1]
    return ()


def _leaps(angle: Array) -> bool:
    """Whether wheel angles (n, 4) go on by more than half a turn in a twentieth of the rows, or more.

    No wheel is that fast between two rows, and a counter that wraps does so once a turn.
    """
    return bool(np.mean(np.abs(np.diff(angle, axis=0)) > np.pi) > _LEAPING)


def _translations_agree(drive: Drive, edges_s: Array, wheels: WheelGeometry, in_any_unit: bool) -> bool:
    """Whether ways of the middle of the wheels agree, whatever the heading; True where it hardly moves.

    Args:
        drive: the recording.
        edges_s: (s + 1,) edges of the stretches, s.
        wheels: wheels of the robot.
        in_any_unit: True where steering angles may be in another unit, too.
    """
    moved = np.abs(by_truth(drive.truth_t_s, drive.pose * (1.0, 1.0, 0.0), edges_s, wheels).mean(axis=1))
    for to_si in (1.0, *(unit.to_si for unit in _STEERING if in_any_unit)):
        angle, steering = np.unwrap(drive.angle, axis=0), drive.steering * to_si
        right = replace(drive, angle=angle, steering=steering)
        middle = np.abs(by_wheels(right, edges_s, wheels).mean(axis=1))
        if min(middle.sum(), moved.sum()) < _WORTH_M or _share(middle, moved, _WRONG) > 1.0 - _MOST:
            return True
    return False


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
        UnitError: names unit and factor.
    """
    edges_s, wheels = drive.edges_s(), nominal.geometry
    moved = by_truth(drive.truth_t_s, drive.pose, edges_s, wheels)
    rolled = by_wheels(drive, edges_s, wheels)
    mask = rolling(rolled, moved, drive.known(edges_s), wheels)
    before = missed(rolled[mask], moved[mask])
    if np.count_nonzero(before > _OFF) < 2:
        return
    size, fits = float(np.max(np.abs(raw))), list[tuple[float, Unit]]()
    for unit in _STEERING:
        if size * unit.to_si > _WITHIN_RAD or (unit.to_si < 1.0 and size < 2.0 * np.pi):
            continue
        way = by_wheels(replace(drive, steering=raw * unit.to_si), edges_s, wheels)
        after = float(np.max(missed(way[mask], moved[mask])))
        if after < min(_AGREES, 0.5 * float(np.max(before))):
            fits.append((after, unit))
    if fits:
        unit = min(fits, key=lambda fit: fit[0])[1]
        raise UnitError(
            where,
            f"steering angles (delta) seem to be in {unit.name}: a wheel misses {100.0 * np.max(before):.0f} "
            "% of its way by ground truth, and all agree once they are converted",
            {"delta": unit.to_si},
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
