"""Corrects the ground truth of a set: a clock that is late or fast, a heading or a centre not the robot's.

What `hil.datasets.truth_fit` measures in a recording is compared over the set. What the recordings have in
common is corrected and said. A recording whose body differs from that of the others contradicts them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.core.geometry import Array
from hil.datasets.changed_wheels import wheel_alone
from hil.datasets.sampling import is_slow
from hil.datasets.truth_deviations import (
    SCALE_STD,
    STDS,
    beyond,
    beyond_alone,
    near_centre,
    significant,
    typical,
    uneven,
)
from hil.datasets.truth_fit import TruthFit, truth_fit
from hil.datasets.truth_sessions import other_sessions
from hil.datasets.wheel_log import Recording

_LATE_S, _PERIODS = 0.03, 0.1
_FAST, _FAST_ALONE = 5e-4, 1e-3
_HEADING_RAD, _HEADING_STD_RAD, _OTHER_RAD, _FAR_RAD = 0.03, 0.01, 0.04, 1.0
_UNLIKELY_M = 0.25
"""Distance of a tracked point from the middle of the wheels that a ground truth alone does not show."""
_REVERSE_RAD = 2.6
_CENTRE_M, _CENTRE_STD_M, _OTHER_M = 0.01, 3e-3, 0.02
_SCALE, _NOTED = 0.03, 1.25
FAR = 0.08
"""Share by which distances may differ; beyond it the geometry is that of another robot."""
EITHER_SCALE = (
    "either its positions are scaled so, or all wheel radii are (and the distances of the wheels, if turns "
    "fit); recordings cannot tell these apart"
)
"""Causes of distances that differ by a factor."""


@dataclass(frozen=True)
class _Found:
    """Errors that a set of recordings has in common; 0 where nothing is to be corrected.

    Attributes:
        late: True for each recording whose ground truth is late or early.
        fast: share by which the clock of the ground truth of each recording runs fast.
        typical_scale: distance by ground truth over distance by wheels in most recordings.
        typical_rad: heading of the ground truth minus the robot's in most recordings.
        heading_rad: the same, 0 where it is not corrected.
        centre_m: tracked point (x + iy) in the frame of the body.
        notes: corrections, in words.
        contradiction: deviations that are not corrected, in words.
        others: what is said of recordings of another session, by index.
    """

    late: Sequence[bool]
    fast: Sequence[float]
    typical_scale: float
    typical_rad: float
    heading_rad: float
    centre_m: complex
    notes: tuple[str, ...]
    contradiction: tuple[str, ...]
    others: Mapping[int, str]


def corrected(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings with corrected ground truth; their `notes` say how.

    Stamps are corrected from 0.03 s on (with slow ground truth a tenth of its period more), a fast clock from
    0.05 % (0.1 % in a single recording), a heading from 0.03 rad (where no single wheel explains it,
    `wheel_alone`), a centre from 10 mm (from 6 mm on `notes` say what it may be). A heading that is 0.04 rad
    from that of most other recordings or 0.015 rad from that of other repetitions, or a centre that is 20 mm
    from theirs, is of another body: `contradictions` say so. A heading that is more than a radian off is not
    corrected, it contradicts; half a turn is left to `wrong_signs`. What is no clock, heading or centre is
    not corrected either: poses spread over 0.15 s, one wheel that is 0.03 s later than the others, axes of
    another scale or sheared by 0.8 %, a heading that drifts by 0.4 mrad/s or turns by 0.5 % further than the
    path, a clock that runs unevenly by 0.04 s. Each has to be four times its standard error, the last one
    twice in most recordings. A single recording contradicts from 1.2 % (axes), 1 mrad/s, or 4 % (scale of all
    positions) on.
    """
    fits = [None if one.contradictions else truth_fit(one) for one in recordings]
    found = _common(recordings, fits)
    return [
        _corrected(one, fit, (late, fast), found, found.others.get(k))
        for k, (one, fit, late, fast) in enumerate(zip(recordings, fits, found.late, found.fast, strict=True))
    ]


def notes_of(recordings: Sequence[Recording]) -> list[str]:
    """What was corrected, each sentence once."""
    return list(dict.fromkeys(note for one in recordings for note in one.notes))


def _common(recordings: Sequence[Recording], fits: Sequence[TruthFit | None]) -> _Found:
    known = [fit for fit in fits if fit is not None]
    centre_m, by_turns = _agreed([(fit.centre_m, fit.centre_std_m) for fit in known], _CENTRE_STD_M, _OTHER_M)
    bodies = [fit for fit in known if fit.centre_std_m < _CENTRE_STD_M]
    same = bool(bodies) and all(abs(fit.centre_m - centre_m) <= _OTHER_M for fit in bodies)
    others = other_sessions(recordings, fits, centre_m if same else None)
    known = [fit for k, fit in enumerate(fits) if fit is not None and k not in others]
    late = [
        fit is not None and abs(fit.late_s) >= _worth_s(one)
        for one, fit in zip(recordings, fits, strict=True)
    ]
    fast = typical([fit.fast for fit in known])
    if abs(fast) < max(_FAST, STDS * _error([fit.fast for fit in known], [fit.fast_std for fit in known])):
        fast = 0.0
    typical_scale = typical([fit.scale for fit in known if fit.scale_std < SCALE_STD]) or 1.0
    fasts = [
        fit.fast if fit and _fast_alone(fit, fast) and not beyond_alone(fit, typical_scale) else fast
        for fit in fits
    ]
    alone = {one.name: own for one, own in zip(recordings, fasts, strict=True) if own != fast}
    point_m = centre_m if bodies else 0j
    headings = [(complex(own), std) for own, std in (_heading(fit, point_m) for fit in known)]
    heading, by_ways = _agreed(headings, _HEADING_STD_RAD, _OTHER_RAD)
    heading_rad = heading.real if abs(heading) >= _HEADING_RAD else 0.0
    if heading_rad and wheel_alone(recordings, recordings[0].nominal.geometry) is not None:
        heading_rad = 0.0
    turns_about_m, centre_m = centre_m, centre_m if abs(centre_m) >= _CENTRE_M else 0j
    delays_s = [
        fit.late_s
        for fit, is_late, own in zip(fits, late, fasts, strict=True)
        if fit and is_late and own == fast
    ]
    notes, contradiction = _of_clocks(delays_s, fast, len(known), alone), tuple[str, ...]()
    scales = [(complex(fit.scale), fit.scale_std) for fit in known if fit.scale_std < SCALE_STD]
    far, typical_rad = abs(heading_rad) > _FAR_RAD, heading.real
    if far and abs(heading_rad) < _REVERSE_RAD:
        contradiction = (
            f"its ground truth moves {_angle(-heading_rad)} beside the direction in which the wheels roll: "
            "set the heading of its body, or mount_rotation_wxyz of [truth]; or x and y are exchanged",
        )
    if contradiction := contradiction or beyond(known):
        still = [0.0] * len(fits)
        return _Found(
            [False] * len(fits), still, typical_scale, typical_rad, 0.0, 0j, (), contradiction, others
        )
    if far:
        heading_rad, centre_m = 0.0, 0j
    notes += _of_body(heading_rad, by_ways, complex(centre_m * np.exp(1j * heading_rad)), by_turns)
    notes += () if centre_m else near_centre(turns_about_m, by_turns)
    notes += _of_scale([(scale - 1.0, std) for scale, std in scales])
    return _Found(
        late, fasts, typical_scale, typical_rad, heading_rad, centre_m, notes, contradiction, others
    )


def _fast_alone(fit: TruthFit, fast: float) -> bool:
    """Whether the clock of one ground truth runs otherwise than those of the others, and evenly."""
    return abs(fit.fast - fast) > max(_FAST_ALONE, STDS * fit.fast_std) and not uneven(fit)


def _corrected(
    one: Recording, fit: TruthFit | None, clock: tuple[bool, float], found: _Found, session: str | None
) -> Recording:
    """A recording with its own delay, and with what is common to all, taken out of its ground truth."""
    unlike = found.contradiction or _unlike(fit, found, session)
    late, fast = clock
    if not found.notes and not unlike:
        return one
    pose, middle_s = one.truth_pose.copy(), 0.5 * float(one.truth_t_s[0] + one.truth_t_s[-1])
    tracked_m = found.centre_m * np.exp(1j * pose[:, 2])
    pose -= np.column_stack([tracked_m.real, tracked_m.imag, np.full(len(pose), found.heading_rad)])
    late_s = fit.late_s if fit is not None and (late or fast) else 0.0

    def at(stamps_s: Array) -> Array:
        return np.asarray(stamps_s - late_s - fast * (stamps_s - middle_s), dtype=np.float64)

    return replace(
        one,
        truth_pose=pose,
        truth_t_s=at(one.truth_t_s),
        truth_receive_s=at(one.truth_receive_s),
        notes=(*one.notes, *found.notes),
        contradictions=(*one.contradictions, *unlike),
    )


def _unlike(fit: TruthFit | None, found: _Found, session: str | None) -> tuple[str, ...]:
    """Why a recording is of another body than the others; `session` of `_Found.others`."""
    if fit is None:
        return ()
    if out := list(beyond_alone(fit, found.typical_scale)):
        return tuple(out)
    own_rad, std_rad = _heading(fit, found.centre_m)
    off_rad, off_m = own_rad - found.typical_rad, fit.centre_m - found.centre_m
    off_rad = (off_rad + np.pi) % (2.0 * np.pi) - np.pi
    far = abs(off_rad) > max(_OTHER_RAD, STDS * std_rad)
    if session:
        out.append(session)
    elif far and std_rad < _HEADING_STD_RAD:
        out.append(
            f"the heading of its ground truth is {off_rad:.2f} rad off that of the other recordings, or all "
            f"its steering angles are {-off_rad:.2f} rad off theirs (a limit, zeros that were set anew)"
        )
    if fit.centre_std_m < _CENTRE_STD_M and abs(off_m) > _OTHER_M:
        out.append(
            f"its ground truth tracks a point {1e3 * abs(off_m):.0f} mm from that of the other recordings"
        )
    return tuple(out)


def _heading(fit: TruthFit, point_m: complex) -> tuple[float, float]:
    """Heading of one ground truth and its standard error, rad; of a known point if its own is unlikely.

    Where the robot slips on a line, a point far from the middle of the wheels seems to be tracked, and the
    heading of the line would follow from it.
    """
    if abs(fit.centre_m - point_m) > _UNLIKELY_M:
        return fit.heading_with(point_m), fit.direction_std_rad
    return fit.heading_rad, fit.heading_std_rad


def _agreed(measured: Sequence[tuple[complex, float]], std: float, tolerance: float) -> tuple[complex, int]:
    """The value that most of the measured ones, with their standard errors, agree with; and their number.

    Two groups are not averaged: one of them is chosen, of two equal ones that of the smaller value. The value
    is a typical one of those that are known to `std`; without any it is 0.
    """
    known = [value for value, own in measured if own < std]

    def agree(value: complex) -> int:
        return sum(abs(other - value) <= max(tolerance, STDS * own) for other, own in measured)

    if not known:
        return 0j, 0
    best = max([0j, *known], key=lambda value: (agree(value), -abs(value)))
    near = [value for value in known if abs(value - best) <= tolerance]
    return complex(typical([v.real for v in near]), typical([v.imag for v in near])), len(near)


def _error(values: Sequence[float], stds: Sequence[float]) -> float:
    """Standard error of the typical value: by the spread of several ones, by its own where it is alone."""
    if len(values) < 3:
        return float(np.mean(stds)) if stds else np.inf
    spread = 1.4826 * float(np.median(np.abs(np.array(values) - np.median(values))))
    return spread / float(np.sqrt(len(values)))


def _worth_s(recording: Recording) -> float:
    """Least delay that is corrected, s."""
    at_s = recording.truth_t_s
    return _LATE_S + (_PERIODS * float(np.median(np.diff(at_s))) if is_slow(at_s) else 0.0)


def _of_clocks(
    late_s: Sequence[float], fast: float, known: int, alone: Mapping[str, float]
) -> tuple[str, ...]:
    """What is corrected of the clocks; `alone` holds those of single recordings, by name."""
    if alone:
        runs = ", ".join(f"{100 * own:+.2f} % in {name}" for name, own in alone.items())
        rest = _of_clocks(late_s, fast, known, {})
        return (
            f"the clock of the ground truth runs at another rate than that of the wheels: {runs}; these "
            "stamps are corrected",
            *rest,
        )
    if fast:
        word = "fast" if fast > 0 else "slow"
        return (
            f"the clock of the ground truth runs {100 * abs(fast):.2f} % {word} against that of the wheels "
            f"(starts and stops of {known} recordings): its stamps are corrected",
        )
    if not late_s:
        return ()
    typical_s = typical(late_s)
    word = "later" if typical_s > 0 else "earlier"
    return (
        f"the ground truth moves {abs(typical_s):.2f} s {word} than the wheels ({len(late_s)} recordings, "
        f"{min(late_s):.2f} to {max(late_s):.2f} s): its stamps are corrected",
    )


def _of_body(heading_rad: float, by_ways: int, centre_m: complex, by_turns: int) -> tuple[str, ...]:
    out = []
    if heading_rad:
        out.append(
            f"the heading of the ground truth is {_angle(heading_rad)} off the direction in which the wheels "
            f"roll ({by_ways} recordings): either its body is set so, or all four steering zeros are as much "
            "off; recordings cannot tell these apart. The heading is corrected here: set the heading of the "
            "body (mount_rotation_wxyz of [truth]) or the zeros"
        )
    if centre_m:
        out.append(
            f"the ground truth tracks a point {1e3 * centre_m.real:.0f} mm ahead and "
            f"{1e3 * centre_m.imag:.0f} mm to the left of the middle of the wheels (turns of {by_turns} "
            "recordings): its positions are "
            "corrected; set the pivot of its body there, or mount_position_m of [truth]"
        )
    return tuple(out)


def _of_scale(off: Sequence[tuple[complex, float]]) -> tuple[str, ...]:
    """Note on a scale of all positions, by shares `off` that the distances differ, and standard errors."""
    scale = 1.0 + significant(off, _SCALE, SCALE_STD).real
    if not _SCALE <= abs(scale - 1.0) <= _NOTED * FAR:
        return ()
    return (
        f"by ground truth the robot goes {scale:.3f} times as far as its wheels roll ({len(off)} "
        f"recordings): {EITHER_SCALE}. Nothing is corrected: measure a path with a tape",
    )


def _angle(angle_rad: float) -> str:
    return f"{angle_rad:.3f} rad ({np.degrees(angle_rad):.1f} deg)"
