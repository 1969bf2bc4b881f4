"""Coupling of the steering axis into the drive encoder, as of coaxial modules: phi grows by a share of delta.

While the body rests by ground truth and the modules steer, no wheel goes anywhere: what phi turns then, per
turn of delta, is the coupling. In a drive it looks like wheels that roll, and a fit bends the steering zeros.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array, Bools
from hil.datasets.wheel_displacements import Drive, by_truth
from hil.datasets.wheel_log import Recording
from hil.robot.kinematics import WheelGeometry

_RESTS_M, _STEERS_RAD = 1.5e-3, 0.05
_LEAST_RAD, _LEAST, _EXPLAINED, _TIMES_SURE = 0.5, 0.02, 0.8, 5.0
_ENOUGH, _MOST = 0.005, 2.0

Four = tuple[float, float, float, float]


@dataclass(frozen=True)
class Coupling:
    """Coupling that the caller asks to be taken out.

    Attributes:
        turns: turns of each drive encoder per turn of its steering axis; None to fit them.
    """

    turns: Four | None = None


def decoupled(
    recordings: Sequence[Recording], geometry: WheelGeometry, asked: Coupling | None
) -> list[Recording]:
    """Recordings without coupling: that which was asked for is taken out, any other is refused.

    Args:
        recordings: recordings of one robot.
        geometry: its wheels on paper.
        asked: coupling to take out.

    Raises:
        DataError: a coupling of 0.02 or more shows that was not asked for, or none can be fitted because no
            recording steers at rest.
    """
    found, sure = _measured(recordings, geometry)
    if asked is not None and asked.turns is None:
        if not np.isfinite(found).all():
            raise DataError(
                _first(recordings),
                "does not show the coupling of the steering into the drive encoders: in no recording do all "
                f"modules turn by {_LEAST_RAD:g} rad while the body rests",
                expected="modules that are steered at rest",
                remedy="record that, or give the coupling as --coupling TURNS",
            )
        turns = found
    else:
        turns = np.zeros(4) if asked is None else np.array(asked.turns)
        left = np.abs(found - turns)
        if np.any(sure & (left > _LEAST) & (left > _ENOUGH + _ENOUGH * np.abs(turns))):
            shown = ", ".join(f"{c:.3f}" for c in found)
            raise DataError(
                _first(recordings),
                "while the body rests and the modules steer, the drive encoders turn along: phi1 to phi4 by "
                f"{shown} of delta: the steering is coupled into the drives",
                expected="phi that grows only as the wheel rolls" if asked is None else "the coupling given",
                remedy="take it out with --coupling fit, or in the file: phi less that share of delta",
            )
    return [_without(one, turns) if turns.any() else one for one in recordings]


def _first(recordings: Sequence[Recording]) -> str:
    return recordings[0].sources[0] if recordings[0].sources else recordings[0].name


def _measured(recordings: Sequence[Recording], geometry: WheelGeometry) -> tuple[Array, Bools]:
    """Turns (4,) of phi per turn of delta at rest, NaN where too little is steered; whether they are sure.

    A gear of two turns of the drive or more per turn of the module is none: then the rest is wrong.
    """
    pairs = [_at_rest(one, geometry) for one in recordings]
    steered, rolled = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
    found, sure = np.full(4, np.nan), np.zeros(4, dtype=np.bool_)
    for i, (d, p) in enumerate(zip(steered.T, rolled.T, strict=True)):
        d, p = d[np.abs(d) > _STEERS_RAD], p[np.abs(d) > _STEERS_RAD]
        if np.abs(d).sum() < _LEAST_RAD or len(d) < 2:
            continue
        found[i] = float(d @ p / (d @ d))
        left = p - found[i] * d
        error = float(np.sqrt(left @ left / (len(d) - 1) / (d @ d)))
        explains = 1.0 - float(left @ left) / max(float(p @ p), 1e-12) > _EXPLAINED
        sure[i] = explains and _TIMES_SURE * error < abs(found[i]) < _MOST
    return found, sure


def _at_rest(one: Recording, geometry: WheelGeometry) -> tuple[Array, Array]:
    """Turns of steering and of wheels (s, 4), rad, in stretches in which the body rests by ground truth.

    A gap of the ground truth counts, too, if behind it the body is where it was: a source without noise
    repeats its pose, and is then taken for a frozen one, since the wheels seem to roll.
    """
    drive = Drive(one.t_s, one.wheel_angle_rad, one.steering_rad, one.truth_t_s, one.truth_pose)
    edges_s = drive.edges_s() if one.has_truth and not one.of_twist else np.zeros(0)
    if len(edges_s) < 2:
        return np.zeros((0, 4)), np.zeros((0, 4))
    moved_m = np.abs(by_truth(one.truth_t_s, one.truth_pose, edges_s, geometry)).max(axis=1)
    rests = moved_m < _RESTS_M
    steered, rolled = (
        np.column_stack([np.diff(np.interp(edges_s, one.t_s, column)) for column in angles.T])[rests]
        for angles in (one.steering_rad, one.wheel_angle_rad)
    )
    return steered, rolled


def _without(one: Recording, turns: Array) -> Recording:
    """Recording whose wheel angles and rates do not contain the coupling."""
    steering_rate = np.gradient(one.steering_rad, one.t_s, axis=0)
    return replace(
        one,
        wheel_angle_rad=one.wheel_angle_rad - turns * (one.steering_rad - one.steering_rad[0]),
        wheel_rate_rad_s=one.wheel_rate_rad_s - turns * steering_rate,
        coupling=tuple(turns.tolist()),
    )
