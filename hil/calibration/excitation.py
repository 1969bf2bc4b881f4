"""Measures the excitation of recordings: distance in each direction; and checks their geometry.

A calibration contains at least a 3x3 map of body motion. If no recording drives a direction on its own, a
column of this map is left to the prior and to what the other motions imply, and odometry extrapolates there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.calibration.motion_models import make_model
from hil.core.errors import DataError
from hil.core.geometry import Array, Bools
from hil.datasets.fit_blocks import Blocks
from hil.datasets.nominal_robot import Nominal, lever_m
from hil.datasets.truth_correction import EITHER_SCALE, FAR
from hil.datasets.wrong_signs import CHECK_COLUMNS
from hil.robot.kinematics import WheelGeometry
from hil.robot.odometry import integrate

DIRECTIONS = ("forward", "sideways", "turning")
_SHARE, _OWN_SHARE = 0.05, 0.2
_WORTH_M, _WORTH_RAD = 0.3, 1.0
_MUCH, _CHORD_M = 0.2, 0.1
BENCH_FILE = "name the robot's bench file with --bench, or correct its [robot] section"
OTHER_ROBOT = f"{BENCH_FILE}; else {CHECK_COLUMNS}"
"""Remedy where distances do not fit the robot: check the geometry first, then the columns."""


@dataclass(frozen=True)
class Driven:
    """Distance that recordings drive, by direction of the body's motion.

    A direction counts as far as it is driven independently of the others: a circle drives ahead and turns at
    once, so one circle excites neither alone, but itself; one of each sense excites both.

    Attributes:
        moment_m: (3, 3) sum of d d' / |d| over all displacements d = (forward, sideways, turning), m; turning
            is converted with the distance of the wheels from the middle.
    """

    moment_m: Array

    @property
    def total_m(self) -> float:
        """Whole distance, m."""
        return float(np.trace(self.moment_m))

    def along(self, ways: Array) -> Array:
        """Distance (n,) driven independently in the directions of displacements (n, 3), m."""
        least = 1e-9 * max(self.total_m, 1.0) * np.eye(3)
        size = np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-12)
        leverage = np.einsum("ni,ij,nj->n", ways / size, np.linalg.inv(self.moment_m + least), ways / size)
        return np.asarray(1.0 / np.maximum(leverage, 1e-30), dtype=np.float64)

    def covers(self, ways: Array) -> Bools:
        """Whether at least a twentieth of the whole distance is along each of displacements (n, 3)."""
        return np.asarray(self.along(ways) >= _SHARE * self.total_m, dtype=np.bool_)

    @property
    def missing(self) -> tuple[str, ...]:
        """Directions that are not covered on their own."""
        return tuple(
            name for name, known in zip(DIRECTIONS, self.covers(np.eye(3)), strict=True) if not known
        )

    def to_json(self) -> dict[str, Any]:
        """`{"forward": m, "sideways": m, "turning": m, "total": m, "moment": 3x3}`."""
        ways_m = self.along(np.eye(3)).tolist()
        return dict(
            zip(
                (*DIRECTIONS, "total", "moment"), [*ways_m, self.total_m, self.moment_m.tolist()], strict=True
            )
        )

    @classmethod
    def from_json(cls, ways_m: Mapping[str, Any]) -> Driven:
        """Inverse of `to_json`."""
        return cls(np.array(ways_m["moment"], dtype=np.float64))


def driven(blocks: Blocks, nominal: WheelGeometry) -> Driven:
    """Distance that recordings drive in each direction, by nominal odometry."""
    step_m = _steps(blocks, nominal).reshape(-1, 3) * _levers(nominal)
    size = np.sqrt(np.sum(step_m**2, axis=1))
    moving = size > 0.0
    return Driven(np.asarray(step_m[moving].T @ (step_m[moving] / size[moving, None]), dtype=np.float64))


def _levers(nominal: WheelGeometry) -> Array:
    """(3,) metres per unit of a body displacement; a turn counts at the wheels' distance from the middle."""
    return np.array([1.0, 1.0, lever_m(nominal)])


def _steps(blocks: Blocks, nominal: WheelGeometry) -> Array:
    """Body displacement (R, N, 3) of every block by nominal odometry."""
    r, n, _ = blocks.wheel_rad.shape
    model = make_model("exact", blocks.wheel_rad.reshape(-1, 8), nominal)
    return model.motion(nominal.vector()).reshape(r, n, 3)


def mismatch(blocks: Blocks, nominal: Nominal) -> str:
    """Reason why the geometry cannot be that of the recorded robot; empty where it can.

    Distances and turns of the recordings by wheels and by ground truth are compared by the median of their
    ratio, so that a single bad recording does not count.
    """
    step = _steps(blocks, nominal.geometry) * blocks.real[..., None]
    truth = np.concatenate([blocks.start[:, None], blocks.truth], axis=1)
    by_truth, by_wheels = np.array([_chords_m(*both) for both in zip(truth, step, strict=True)]).T
    turn = np.diff(truth[..., 2], axis=1) * blocks.real
    far = _ratio(by_truth, by_wheels, _WORTH_M)
    much = _ratio(np.abs(turn.sum(axis=1)), np.abs(step[..., 2].sum(axis=1)), _WORTH_RAD)
    wrong = [f"went {far:.2f} times as far"] if abs(far - 1.0) > FAR else []
    wrong += [f"turned {much:.2f} times as much"] if abs(much - 1.0) > _MUCH else []
    if not wrong:
        return ""
    found = f"by ground truth the robot {' and '.join(wrong)} as its wheels say"
    if abs(far - 1.0) > FAR:
        found += f" ({EITHER_SCALE})"
    return f"{found}; {nominal.in_words()}"


def _ratio(by_truth: Array, by_wheels: Array, worth: float) -> float:
    """Median ratio over the recordings that drive at least `worth`; 1 without any."""
    enough = by_wheels > worth
    return float(np.median(by_truth[enough] / by_wheels[enough])) if enough.any() else 1.0


def _chords_m(truth: Array, step: Array) -> tuple[float, float]:
    """Way by truth (n + 1, 3) and by body displacements (n, 3), m, in chords of 0.1 m of the wheels' way.

    Noise of the ground truth adds up over short steps; over a chord it does not count.
    """
    way_m = np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]))])
    ends = np.unique(np.searchsorted(way_m, np.arange(0.0, way_m[-1], _CHORD_M)))
    by_wheels = integrate(np.zeros(3), step, "exponential")
    far, rolled = (np.diff(poses[ends, :2], axis=0) for poses in (truth, by_wheels))
    return float(np.hypot(*far.T).sum()), float(np.hypot(*rolled.T).sum())


def check_geometry(blocks: Blocks, nominal: Nominal) -> None:
    """Refuse recordings that contradict the geometry; raises `DataError`."""
    found = mismatch(blocks, nominal)
    if found:
        raise DataError(
            "",
            f"the geometry does not fit the recordings: {found}",
            expected=f"agreement within {100 * FAR:.0f} % (turns: {100 * _MUCH:.0f} %)",
            remedy=OTHER_ROBOT,
        )


def undriven(blocks: Blocks, nominal: WheelGeometry, known: Driven) -> dict[str, tuple[str, ...]]:
    """Motions that a calibration's recordings did not drive, with their directions.

    Args:
        blocks: recordings to check.
        nominal: nominal geometry.
        known: distances of the calibration's own recordings.
    """
    out: dict[str, tuple[str, ...]] = {}
    for motion, step in zip(blocks.motions, _steps(blocks, nominal), strict=True):
        ways_m = step * _levers(nominal)
        size = np.linalg.norm(ways_m, axis=1)
        if size[~known.covers(ways_m)].sum() > _OWN_SHARE * size.sum():
            shares = np.abs(ways_m).sum(axis=0) / np.abs(ways_m).sum()
            out[motion] = tuple(n for n, share in zip(DIRECTIONS, shares, strict=True) if share > _OWN_SHARE)
    return out
