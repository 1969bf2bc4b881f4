"""Ground truth in a file of its own, joined with a wheel log by time.

Both have one clock, or `offset_s` shifts the ground truth, or the shift is fitted: at it the speeds of the
wheels by their angles and by the ground truth are most alike.
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.core.errors import DataError, UsageError
from hil.core.geometry import Array
from hil.datasets.capture_files.formats import FORMATS, Format, format_of, text_of
from hil.datasets.capture_files.poses import planar
from hil.datasets.cleaning import Log, count
from hil.datasets.nominal_robot import Nominal
from hil.datasets.unpacking import read_packed
from hil.datasets.wheel_displacements import by_truth

_GRID_S, _WINDOW_S = 0.02, 0.2
_ALIKE, _ALONE, _APART_S = 0.95, 0.02, 0.5
_COVERED, _TIMES = 0.7, 4.0
SHIFTED = "shift of the ground truth by {:.3f} s fitted, at which its speed and the wheels' are most alike"


@dataclass(frozen=True)
class TruthFile:
    """Ground truth as the caller names it.

    Attributes:
        path: file of all wheel logs, or folder with one file for each, of the same name but for its ending.
        body: name of the body; needed where a file holds several.
        offset_s: time to add to its stamps, s.
        fitted: True to fit that time instead.
    """

    path: Path
    body: str | None = None
    offset_s: float = 0.0
    fitted: bool = False

    def of(self, wheels: Path) -> Path:
        """File that belongs to a wheel log; raises `DataError` where there is none, or several."""
        if not self.path.is_dir():
            return self.path
        stem = wheels.name.removesuffix(".gz").rpartition(".")[0]
        found = sorted(one for one in self.path.glob(f"{stem}.*") if one.resolve() != wheels.resolve())
        if len(found) != 1:
            raise DataError(
                str(self.path),
                f"holds {len(found)} files of the name {stem} for {wheels.name}",
                expected="one file of ground truth for each wheel log",
            )
        return found[0]


def refuse_truth_alone(path: Path, data: bytes) -> None:
    """Raise `DataError`, which names the format, for a file of ground truth in place of a wheel log."""
    if known := format_of(data):
        raise DataError(
            str(path),
            f"is a {known.name}: it holds poses, and no wheel angles",
            expected="a wheel log",
            remedy=f"name the wheel log, and this as its ground truth: WHEELS.csv --truth {path}",
        )


def read_truth(
    given: TruthFile, wheels: Path, log: Log, nominal: Nominal, repairs: dict[str, int]
) -> tuple[Log, str, str]:
    """Ground truth of a wheel log, on its clock (columns x, y, theta), and name and SHA-256 of its file.

    Args:
        given: ground truth as the caller named it.
        wheels: file of the wheel log.
        log: wheel rows, as in the file.
        nominal: robot that it is read for.
        repairs: counts of repairs by name; changed in place.

    Raises:
        DataError: the file is none of the known formats, or its body is not clear, or no shift fits.
    """
    path = given.of(wheels)
    data = read_packed(path)
    if (known := format_of(data)) is None:
        raise DataError(
            str(path),
            "is no file of ground truth that is known",
            expected="one of " + ", ".join(one.name for one in FORMATS),
        )
    t_s, pose = _planar(path, known, data, given.body, repairs)
    t_s = t_s + given.offset_s
    if given.fitted:
        shift_s = _fitted_s(path, log, t_s, pose, nominal)
        count(repairs, SHIFTED.format(shift_s), 1)
        t_s = t_s + shift_s
    else:
        _check_shared(path, log.t_s, t_s)
    return Log(t_s, pose), str(path), hashlib.sha256(data).hexdigest()


def _planar(
    path: Path, known: Format, data: bytes, body: str | None, repairs: dict[str, int]
) -> tuple[Array, Array]:
    bodies = known.read(str(path), text_of(data))
    names = ", ".join(bodies)
    if body is not None and body not in bodies:
        raise UsageError(f"{path} has no body {body!r}", expected=f"one of {names}")
    if body is None and len(bodies) != 1:
        raise UsageError(
            f"{path} holds {len(bodies)} bodies ({names})", remedy="name the robot's with --truth-body"
        )
    up, t_s, pose = planar(str(path), bodies[body or next(iter(bodies))], known.up)
    if up != known.up:
        what = f"plane of the ground truth, normal to {up} by its motion ({known.up} is usual in such files)"
        count(repairs, what, 1)
    return t_s, pose


def _check_shared(path: Path, t_s: Array, truth_s: Array) -> None:
    """Refuse ground truth that shares less than a second with the wheels; says how far apart they are."""
    if min(np.nanmax(t_s), truth_s[-1]) - max(np.nanmin(t_s), truth_s[0]) >= 1.0:
        return
    raise DataError(
        str(path),
        f"begins {truth_s[0] - np.nanmin(t_s):.3f} s after the wheels and lasts {np.ptp(truth_s):.1f} s; "
        f"they share less than a second (the wheels last {np.nanmax(t_s) - np.nanmin(t_s):.1f} s)",
        expected="stamps of one clock",
        remedy="add --truth-offset fit, or the seconds to add to its stamps, as --truth-offset SECONDS",
    )


def _fitted_s(path: Path, log: Log, truth_s: Array, pose: Array, nominal: Nominal) -> float:
    """Time to add to the stamps of the ground truth, s, so that its speed is most like that of the wheels.

    Raises:
        DataError: no shift makes them alike, or another shift does as well.
    """
    known = np.isfinite(log.t_s) & np.isfinite(log.values[:, :4]).all(axis=1)
    at_s, order = np.unique(log.t_s[known], return_index=True)
    angle = np.unwrap(log.values[known, :4][order], axis=0) * nominal.radius_m
    truth_s, order = np.unique(truth_s, return_index=True)
    pose = np.column_stack([pose[order, :2], np.unwrap(pose[order, 2])])
    grid_s, seen_s = (np.arange(t[0], t[-1], _GRID_S) for t in (at_s, truth_s))
    steps = np.column_stack([np.diff(np.interp(grid_s, at_s, column)) for column in angle.T])
    rolled = _smooth(np.abs(steps).mean(axis=1))
    moved = _smooth(np.abs(by_truth(truth_s, pose, seen_s, nominal.geometry)).mean(axis=1))
    scores = _likeness(rolled, moved)
    best = int(np.argmax(scores))
    near = scores >= scores[best] - _ALONE
    below = np.cumsum(~near)
    rivals = np.flatnonzero(near & (np.abs(below - below[best]) > round(_APART_S / _GRID_S)))
    if scores[best] < _ALIKE or len(rivals):
        first_s = float(seen_s[0] - grid_s[0]) - _GRID_S * (len(rolled) - 1)
        shifts = [first_s + _GRID_S * k for k in (best, *rivals[:1].tolist(), best)]
        why = f"no shift makes its speed like that of the wheels (at best {100.0 * scores[best]:.0f} % alike)"
        several = f"shifts by {-shifts[0]:.2f} and {-shifts[1]:.2f} s fit alike"
        raise DataError(
            str(path),
            why if scores[best] < _ALIKE else several,
            expected="one motion, seen by both",
            remedy="give the shift with --truth-offset SECONDS",
        )
    part = 0.0
    if 0 < best < len(scores) - 1:
        left, top, right = scores[best - 1 : best + 2]
        part = float(np.clip(0.5 * (left - right) / (left - 2.0 * top + right), -1.0, 1.0))
    later_s = _GRID_S * (best + part - len(rolled) + 1)
    return -float(seen_s[0] - grid_s[0] + later_s)


def _smooth(speed: Array) -> Array:
    n = round(_WINDOW_S / _GRID_S)
    return np.convolve(speed, np.full(n, 1.0 / n), mode="same")


def _likeness(rolled: Array, moved: Array) -> Array:
    """Cosine of two speeds, (n,) and (m,), at each shift (n + m - 1,); 0 where they are not comparable.

    That is where most of neither is covered, or one is more than twice the other.
    """
    size = len(rolled) + len(moved) - 1

    def correlated(one: Array, other: Array) -> Array:
        spectrum = np.fft.rfft(other, size) * np.fft.rfft(one[::-1], size)
        return np.asarray(np.fft.irfft(spectrum, size), dtype=np.float64)

    by_wheels = correlated(rolled**2, np.ones_like(moved))
    by_truth_too = correlated(np.ones_like(rolled), moved**2)
    covered = np.maximum(by_wheels / np.sum(rolled**2), by_truth_too / np.sum(moved**2)) > _COVERED
    energy = np.sqrt(np.maximum(by_wheels * by_truth_too, 0.0))
    least = 1e-6 * float(energy.max(initial=0.0)) + 1e-30
    alike = (by_wheels < _TIMES * by_truth_too + least) & (by_truth_too < _TIMES * by_wheels + least)
    return np.where(covered & alike, correlated(rolled, moved) / np.maximum(energy, least), 0.0)
