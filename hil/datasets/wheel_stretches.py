"""Stretches of half a second of a recording: the ways of its wheels by their angles and by ground truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from hil.core.geometry import Array, Bools
from hil.datasets.sampling import interpolate
from hil.datasets.wheel_displacements import Complexes, Drive, by_truth, by_wheels, rolling
from hil.datasets.wheel_log import Recording

_FEWEST, _TYPICAL, _GOES, _NOTHING_M = 10, 90.0, 0.5, 1e-6


@dataclass(frozen=True)
class Stretches:
    """Stretches (s) of half a second of a recording in which its wheels roll.

    Attributes:
        at_s: (s,) middle, s since the begin of the recording.
        rolled: (s, 4) ways of the wheels by their angles, m.
        moved: (s, 4) ways by ground truth.
        turned: (s, 4) turns of the wheel angles, rad.
        steering: (2, s, 4) steering angles at begin and end, rad.
    """

    at_s: Array
    rolled: Complexes
    moved: Complexes
    turned: Array
    steering: Array

    @classmethod
    def of(cls, one: Recording) -> Stretches | None:
        """The stretches of a recording; None where it has too few, or contradicts itself anyway. Cached."""
        if "stretches" not in one.derived:
            one.derived["stretches"] = cls._found(one)
        return cast("Stretches | None", one.derived["stretches"])

    @classmethod
    def _found(cls, one: Recording) -> Stretches | None:
        if not one.has_truth or one.of_twist or one.contradictions:
            return None
        drive = Drive(one.t_s, one.wheel_angle_rad, one.steering_rad, one.truth_t_s, one.truth_pose)
        edges_s, wheels = drive.edges_s(), one.nominal.geometry
        if len(edges_s) < _FEWEST:
            return None
        rolled, moved = (
            by_wheels(drive, edges_s, wheels),
            by_truth(one.truth_t_s, drive.pose, edges_s, wheels),
        )
        mask = rolling(rolled, moved, drive.known(edges_s), wheels)
        phi, delta = (interpolate(edges_s, one.t_s, c) for c in (one.wheel_angle_rad, one.steering_rad))
        at_s = 0.5 * (edges_s[1:] + edges_s[:-1]) - one.t_s[0]
        pair = np.stack([delta[:-1], delta[1:]])[:, mask]
        made = cls(at_s[mask], rolled[mask], moved[mask], np.abs(np.diff(phi, axis=0))[mask], pair)
        return made if len(made.at_s) >= _FEWEST else None

    @property
    def off_rad(self) -> Array:
        """Direction (s, 4) in which each wheel goes by ground truth, minus that of its steering angle."""
        return np.angle(self.moved * np.conj(self.rolled))

    @property
    def middle_rad(self) -> Array:
        """Steering angles (s, 4) in the middle."""
        return np.asarray(self.steering.mean(axis=0), dtype=np.float64)

    @property
    def goes(self) -> Bools:
        """Mask (s, 4) of wheels that clearly move by ground truth."""
        size = np.abs(self.moved)
        return np.asarray(size > _GOES * float(np.percentile(size, _TYPICAL)), dtype=np.bool_)

    @property
    def scale(self) -> float | None:
        """Way of the middle by ground truth over that by wheels, the median; None where it hardly moves."""
        rolled, moved = self.rolled.mean(axis=1), self.moved.mean(axis=1)
        goes = np.abs(rolled) > _GOES * float(np.percentile(np.abs(self.rolled), _TYPICAL))
        if np.count_nonzero(goes) < _FEWEST:
            return None
        along = (np.conj(rolled) * moved).real[goes] / np.abs(rolled[goes]) ** 2
        return float(np.median(along))

    @property
    def off(self) -> Complexes | None:
        """Logarithms (4,) of the true way over the own one, medians; None where a wheel hardly moves."""
        goes = self.goes & (np.abs(self.rolled) > _NOTHING_M)
        if np.count_nonzero(goes, axis=0).min() < _FEWEST:
            return None
        every = [np.log(self.moved[rows, i] / self.rolled[rows, i]) for i, rows in enumerate(goes.T)]
        return np.array([complex(np.median(one.real), np.median(one.imag)) for one in every])
