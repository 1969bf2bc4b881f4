"""Finds wheels that differ between recordings of one motion, or alone differ from the other three.

Each wheel's way is compared with the ground truth at its own place. Their ratio is a complex number: its
angle is the error of the steering angle, its size that of the radius or of the wheel angle. Tolerances of a
robot are the same in all repetitions of a motion; a wheel that differs there was set anew, slipped or was
misread.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.core.signals import WHEELS
from hil.datasets.odd_wheels import ways
from hil.datasets.wheel_displacements import Complexes
from hil.datasets.wheel_log import Recording
from hil.robot.kinematics import WheelGeometry

_CHANGED, _OTHERS = 0.06, 0.5
_ALONE, _TOGETHER = 0.15, 0.05
_LEAST_M = 1e-6


def with_changed_wheels(recordings: Sequence[Recording], geometry: WheelGeometry) -> list[Recording]:
    """The recordings; `notes` of the first one name wheels that differ (`changed_wheels`)."""
    found = changed_wheels([one for one in recordings if not one.contradictions], geometry)
    if not found:
        return list(recordings)
    first, *others = recordings
    return [replace(first, notes=(*first.notes, *found)), *others]


def changed_wheels(recordings: Sequence[Recording], geometry: WheelGeometry) -> tuple[str, ...]:
    """One sentence for each wheel that differs between recordings, or alone differs from the other three.

    Between repetitions of a motion it differs by 0.06 (rad, or share of its way), and the other wheels by
    less than half as much. In most recordings it is off by 0.15, and the others by less than 0.05.

    Args:
        recordings: recordings of one robot.
        geometry: wheels that the ways are computed for.
    """
    logs = _logs(recordings, geometry)
    by_motion = dict[str, list[str]]()
    for one in recordings:
        if one.name in logs:
            by_motion.setdefault(one.motion, []).append(one.name)
    if not logs:
        return ()
    middle = _middle(np.array(list(logs.values())))
    alone = _alone(middle)
    out = list[str]()
    if alone is not None:
        out.append(
            f"the {WHEELS[alone]} wheel (phi{alone + 1}, delta{alone + 1}) alone differs from the ground "
            f"truth in most recordings, {_amount(middle[alone], alone)}; the other three agree: look at its "
            "zero and its radius"
        )
    named = dict[int, list[str]]()
    for names in by_motion.values():
        if len(names) == 2:  # the one that is further from what this wheel does elsewhere
            names.sort(key=lambda name: float(np.max(np.abs(logs[name] - middle))))
        for name in names if len(names) > 2 else names[1:]:
            other = _middle(np.array([logs[n] for n in names if n != name]))
            wheel = _only(logs[name] - other, _CHANGED, _OTHERS)
            if wheel is not None:
                named.setdefault(wheel, []).append(f"{name} ({_amount((logs[name] - other)[wheel], wheel)})")
    return (
        *out,
        *(
            f"the {WHEELS[wheel]} wheel differs between repetitions of a motion, the others do not: "
            f"{', '.join(found)} against the other repetitions; it was set anew, misread, or slipped"
            for wheel, found in named.items()
        ),
    )


def wheel_alone(recordings: Sequence[Recording], geometry: WheelGeometry) -> int | None:
    """Index of the wheel that in most recordings is off by 0.15 and the others by less than 0.05; or None."""
    logs = _logs(recordings, geometry)
    return _alone(_middle(np.array(list(logs.values())))) if logs else None


def _alone(middle: Complexes) -> int | None:
    return _only(middle, _ALONE, _TOGETHER / _ALONE)


def _logs(recordings: Sequence[Recording], geometry: WheelGeometry) -> dict[str, Complexes]:
    return {one.name: off for one in recordings if (off := _off(one, geometry)) is not None}


def _off(one: Recording, geometry: WheelGeometry) -> Complexes | None:
    """Logarithm (4,) of the true way of each wheel over its own; None where one hardly rolls."""
    rolled, moved = ways(one, geometry)
    size = np.sum(np.abs(rolled) ** 2, axis=0)
    if len(rolled) == 0 or size.min() < _LEAST_M:
        return None
    return np.asarray(np.log(np.sum(np.conj(rolled) * moved, axis=0) / size))


def _middle(logs: Complexes) -> Complexes:
    """Medians (4,) of values (n, 4), of real and imaginary parts."""
    return np.asarray(np.median(logs.real, axis=0) + 1j * np.median(logs.imag, axis=0))


def _only(off: Complexes, least: float, others: float) -> int | None:
    """The wheel that is off by `least` while the others are off by less than this share of it; else None."""
    size = np.abs(off)
    wheel = int(np.argmax(size))
    rest = float(np.delete(size, wheel).max())
    return wheel if size[wheel] > least and rest < others * size[wheel] else None


def _amount(off: complex, wheel: int) -> str:
    """What undoes it: a change of the steering angle, or of the scale of the wheel angle."""
    if abs(off.imag) > abs(off.real):
        return f"it would agree if delta{wheel + 1} were {off.imag:+.2f} rad further"
    return f"it would agree if phi{wheel + 1} grew {np.exp(off.real):.2f} times as much"
