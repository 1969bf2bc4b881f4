"""Finds repetitions of a motion that differ in how their wheels go by ground truth, and what explains it.

Each wheel's true way over its own one is a complex number, see `hil.datasets.changed_wheels`. Tolerances and
slip are the same in all repetitions. Their differences are compared with what each cause predicts in each
motion: one wheel that was set anew, misread or lost counts; all four steering zeros; another heading of the
body of the ground truth; another tracked point; both. A cause is named where it leaves little, and each
other one clearly more.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.core.geometry import Array
from hil.core.signals import WHEELS
from hil.datasets.repetition_groups import Groups, against, by_motion, chosen
from hil.datasets.truth_deviations import STDS
from hil.datasets.wheel_displacements import Complexes
from hil.datasets.wheel_log import Recording
from hil.datasets.wheel_stretches import Stretches

_DIFFERS, _MOTIONS, _FAR = 0.012, 2, 0.5
"""Difference of two repetitions (rad, share of the way): in one motion 0.006 at most of the real recordings,
and 0.007 of noisy ones in two; by noise of the ground truth four standard errors. Beyond `_FAR` other checks
name what it is."""
_LEFT, _CLEARLY, _NOISE, _IN_MOST = 0.3, 3.0, 0.003, 0.8
"""Share of the squared differences that a cause may leave, by how much more all others have to leave, noise,
and the share of recordings in which it has to."""
_BY_METRE, _SHOWN_M = 0.3, 0.01
"""A metre to the tracked point is as unlikely as this difference; it is told from a centimetre on."""
_HEADING, _ZEROS, _POINT, _BODY = "heading", "zeros", "point", "body"
_UNKNOWN = (
    "by ground truth its wheels go otherwise than in other repetitions of its motion ({}), and no group is "
    "the larger one: which is right is not known"
)
_OTHERWISE = "by ground truth its wheels go otherwise than in {} other repetitions of its motion, which agree"


@dataclass(frozen=True)
class _Ways:
    """How the wheels of a recording go by ground truth.

    Attributes:
        off: (4,) logarithms of the true way of each wheel over its own one.
        std: (4,) standard errors of each part of these, by white noise of the ground truth.
        by_heading: (4,) change of these with the heading of the ground truth, rad: none in turns on the spot.
        by_point: (4,) change of these with the tracked point (x + iy, m).
    """

    off: Complexes
    std: Array
    by_heading: Complexes
    by_point: Complexes

    @classmethod
    def of(cls, one: Recording) -> "_Ways | None":
        own = Stretches.of(one)
        if own is None or own.off is None or np.abs(own.off).max() > _FAR:
            return None
        wheels = one.nominal.geometry
        place = wheels.x_m + 1j * wheels.y_m
        turn = ((own.moved[:, 0] - own.moved[:, 2]) / (1j * (place[0] - place[2]))).real
        by = (-1j * own.moved.mean(axis=1), 1j * turn)
        shares = ([way[rows] / own.moved[rows, i] for i, rows in enumerate(own.goes.T)] for way in by)
        return cls(
            own.off,
            own.off_std,
            *(np.array([complex(np.median(g.real), np.median(g.imag)) for g in one]) for one in shares),
        )


def with_unlike_repetitions(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings; `contradictions` name those that differ from other repetitions, in two motions or more.

    A factor that all wheels have in common is left to `hil.datasets.truth_sessions`: a clock may explain it.
    """
    found = {k: ways for k, one in enumerate(recordings) if (ways := _Ways.of(one)) is not None}
    motions = by_motion(recordings, found, lambda a, b: _differ(found[a], found[b]))
    if sum(len(groups) > 1 for groups in motions.values()) < _MOTIONS:
        return list(recordings)
    choice = chosen(motions, lambda groups: None)
    base = {k: _middle([found[i].off for i in kept]) for k, kept in choice.kept.items()}
    base |= {k: _middle([found[i].off for i in groups[0]]) for k, groups in choice.open.items()}
    lack = {k: _without_scale(found[k].off - base[k]) for k in base}
    lack = {k: own for k, own in lack.items() if np.abs(own).max() > _DIFFERS}
    cause = _cause(lack, found)
    names = [one.name for one in recordings]
    out = list(recordings)
    for k in sorted({*choice.kept, *choice.open}):
        if k in choice.kept:
            said = _OTHERWISE.format(len(choice.kept[k])) + _as_if(cause, lack.get(k), found[k])
        else:
            said = _UNKNOWN.format(against(choice.open[k], names)) + _sizes(
                cause, choice.open[k], lack, found
            )
        out[k] = out[k].contradicted(said)
    return out


def _differ(one: _Ways, other: _Ways) -> bool:
    """Whether two repetitions differ by more than usual, and than noise of their ground truth explains."""
    bounds = np.maximum(_DIFFERS, STDS * np.hypot(one.std, other.std))
    return bool(np.any(np.abs(_without_scale(one.off - other.off)) > bounds))


def _without_scale(off: Complexes) -> Complexes:
    return np.asarray(off - off.real.mean())


def _middle(offs: Sequence[Complexes]) -> Complexes:
    every = np.array(offs)
    return np.asarray(np.median(every.real, axis=0) + 1j * np.median(every.imag, axis=0))


def _columns(cause: str, ways: _Ways) -> Array:
    """Columns (8, c) of what a cause does to the real and imaginary parts of all wheels."""
    one = np.ones(len(WHEELS), dtype=np.complex128)
    if cause in WHEELS:
        alone = np.eye(len(WHEELS))[WHEELS.index(cause)] + 0j
        columns = [alone - alone.mean(), 1j * alone]
    else:
        columns = [1j * one] if cause == _ZEROS else []
        columns += [ways.by_heading] if cause in (_HEADING, _BODY) else []
        columns += [ways.by_point, 1j * ways.by_point] if cause in (_POINT, _BODY) else []
    columns = [_without_scale(c) for c in columns]
    return np.array([np.concatenate([c.real, c.imag]) for c in columns]).T


def _fitted(cause: str, lack: Complexes, ways: _Ways) -> tuple[Array, float]:
    """Coefficients of a cause, and the sum of squares that it leaves."""
    columns, wanted = _columns(cause, ways), np.concatenate([lack.real, lack.imag])
    prior = _BY_METRE * np.eye(columns.shape[1])[columns.shape[1] - 2 :]
    if cause in (_POINT, _BODY):
        columns, wanted = np.vstack([columns, prior]), np.append(wanted, np.zeros(2))
    x = np.linalg.lstsq(columns, wanted, rcond=1e-6)[0]
    return np.asarray(x), float(np.sum((wanted - columns @ x) ** 2))


def _cause(lack: Mapping[int, Complexes], found: Mapping[int, _Ways]) -> str:
    """The cause that explains most recordings and leaves clearly less than others; empty where none does.

    On straight paths the heading and all four zeros explain the same: the heading then stands for both.
    """
    single = (*WHEELS, _HEADING, _ZEROS, _POINT)
    each = {c: np.array([_fitted(c, own, found[k])[1] for k, own in lack.items()]) for c in (*single, _BODY)}
    noise = 2 * len(WHEELS) * _NOISE**2
    most = np.array([max(noise, _LEFT * float(np.sum(np.abs(own) ** 2))) for own in lack.values()])
    explains = [c for c, left in each.items() if np.mean(left <= most) >= _IN_MOST]
    left = {c: max(float(own.sum()), 0.25 * noise * len(lack)) for c, own in each.items()}

    def clear(one: str, than: Sequence[str]) -> bool:
        return one in explains and all(left[c] > _CLEARLY * left[one] for c in than if c != one)

    for one in single:
        if clear(one, [c for c in single if (one, c) != (_HEADING, _ZEROS)]):
            return one
    return _BODY if clear(_BODY, (*WHEELS, _ZEROS)) else ""


def _as_if(cause: str, lack: Complexes | None, ways: _Ways) -> str:
    """What would explain a recording's difference, with its size."""
    if lack is None:
        return ""
    if not cause:
        each = ", ".join(
            f"{name} {1.0 + off.real:.3f} times as far and {off.imag:+.3f} rad beside"
            for name, off in zip(WHEELS, lack, strict=True)
        )
        return f": {each}; no single wheel, heading or tracked point explains this in all motions"
    x = _fitted(cause, lack, ways)[0]
    if cause in WHEELS:
        i = WHEELS.index(cause) + 1
        return (
            f": the {cause} wheel alone, as if {_of_wheel(x, i)}; it was set anew, misread, lost counts or "
            "slipped"
        )
    said = list[str]()
    if cause == _ZEROS:
        said.append(
            f"all its steering angles (delta) are {-x[0]:.2f} rad off theirs, also in turns, where the "
            "heading of the ground truth does not matter: their zeros were set anew"
        )
    if cause in (_HEADING, _BODY):
        said.append(
            f"the heading of its ground truth is {x[0]:.2f} rad off theirs, or all its steering angles are "
            f"{-x[0]:.2f} rad off (zeros that were set anew)"
        )
    if cause in (_POINT, _BODY) and np.linalg.norm(x[-2:]) > _SHOWN_M:
        said.append(
            f"its ground truth tracks a point {1e3 * float(np.linalg.norm(x[-2:])):.0f} mm from theirs"
        )
    return ": " + "; ".join(said)


def _of_wheel(x: Array, number: int) -> str:
    factor, turn = (
        f"phi{number} grew {np.exp(x[0]):.3f} times as much",
        f"delta{number} were {x[1]:+.3f} rad further",
    )
    small = 0.3 * float(np.abs(x).max())
    return " and ".join(said for said, size in ((factor, x[0]), (turn, x[1])) if abs(size) > small)


def _sizes(cause: str, groups: Groups, lack: Mapping[int, Complexes], found: Mapping[int, _Ways]) -> str:
    """What would explain the largest difference between the groups of a motion."""
    members = [k for group in groups for k in group if k in lack]
    far = max(members, key=lambda k: float(np.abs(lack[k]).max()), default=None)
    return "" if far is None else _as_if(cause, lack[far], found[far])
