"""Stretches of half a second of a recording: the ways of its wheels by their angles and by ground truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from hil.core.geometry import Array, Bools
from hil.datasets.sampling import interpolate
from hil.datasets.truth_noise import MEDIAN, noise_of_ways_m, white_noise
from hil.datasets.wheel_displacements import Complexes, Drive, by_truth, by_wheels, rolling
from hil.datasets.wheel_log import Recording

_FEWEST, _TYPICAL, _GOES, _NOTHING_M = 10, 90.0, 0.5, 1e-6


@dataclass(frozen=True)
class Stretches:
    """Stretches (s) of half a second of a recording in which its wheels roll.

    Attributes:
        at_s: (s,) middle, s since the begin of the recording.
        lasts_s: (s,) length, s.
        heading_rad: (s,) heading of the body by ground truth, the mean of begin and end.
        rolled: (s, 4) ways of the wheels by their angles, m.
        moved: (s, 4) ways by ground truth.
        turned: (s, 4) turns of the wheel angles, rad.
        steering: (2, s, 4) steering angles at begin and end, rad.
        noise_m: (5,) standard deviations of a component of the ways by ground truth, of the wheels and the
            middle, by white noise of its poses.
        noise_rad: standard deviation of the heading.
    """

    at_s: Array
    lasts_s: Array
    heading_rad: Array
    rolled: Complexes
    moved: Complexes
    turned: Array
    steering: Array
    noise_m: Array
    noise_rad: float

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
        at_s, lasts_s = 0.5 * (edges_s[1:] + edges_s[:-1]) - one.t_s[0], np.diff(edges_s)
        heading = np.interp(edges_s, one.truth_t_s, one.truth_pose[:, 2])
        heading_rad = 0.5 * (heading[1:] + heading[:-1])
        pair = np.stack([delta[:-1], delta[1:]])[:, mask]
        turned = np.abs(np.diff(phi, axis=0))[mask]
        noise = noise_of_ways_m(one), float(white_noise(one)[2])
        when = at_s[mask], lasts_s[mask], heading_rad[mask]
        made = cls(*when, rolled[mask], moved[mask], turned, pair, *noise)
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
        rolled, moved, goes = self.rolled.mean(axis=1), self.moved.mean(axis=1), self._goes_as_a_whole()
        if np.count_nonzero(goes) < _FEWEST:
            return None
        along = (np.conj(rolled) * moved).real[goes] / np.abs(rolled[goes]) ** 2
        return float(np.median(along))

    @property
    def scale_std(self) -> float:
        """Standard error of the scale by white noise of the ground truth; infinite without a scale."""
        size = np.abs(self.rolled.mean(axis=1))
        size = size[self._goes_as_a_whole()]
        return _error(float(self.noise_m[-1]) / size) if len(size) >= _FEWEST else np.inf

    @property
    def off(self) -> Complexes | None:
        """Logarithms (4,) of the true way over the own one, medians; None where a wheel hardly moves."""
        goes = self.goes & (np.abs(self.rolled) > _NOTHING_M)
        if np.count_nonzero(goes, axis=0).min() < _FEWEST:
            return None
        every = [np.log(self.moved[rows, i] / self.rolled[rows, i]) for i, rows in enumerate(goes.T)]
        return np.array([complex(np.median(one.real), np.median(one.imag)) for one in every])

    @property
    def off_std(self) -> Array:
        """Standard errors (4,) of each part of `off` by white noise of the ground truth."""
        goes, size = self.goes, np.abs(self.moved)
        sizes = [size[rows, i] for i, rows in enumerate(goes.T)]
        noises = zip(self.noise_m, sizes, strict=False)
        return np.array([_error(np.hypot(noise_m / own, self.noise_rad)) for noise_m, own in noises])

    def _goes_as_a_whole(self) -> Bools:
        """Mask (s,) of stretches in which the middle goes by its wheels."""
        size = np.abs(self.rolled.mean(axis=1))
        return np.asarray(size > _GOES * float(np.percentile(np.abs(self.rolled), _TYPICAL)), dtype=np.bool_)


def _error(each: Array) -> float:
    """Standard error of the median of values (n,) with these standard deviations."""
    return float(MEDIAN * np.sqrt(np.mean(each**2) / len(each)))
