"""Finds single wheels that contradict the ground truth while the others agree, and what is wrong with them.

Each wheel is compared with the ground truth at its own place, in stretches of half a second. A cause is named
only if the wheel agrees once it is undone.
"""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array
from hil.core.signals import WHEELS
from hil.datasets.nominal_robot import Nominal
from hil.datasets.wheel_displacements import Complexes, Drive, by_truth, by_wheels, missed, rolling
from hil.datasets.wheel_log import Recording
from hil.robot.kinematics import WheelGeometry

_ODD, _AGREES = 0.3, 0.2
_EXPLAINED = 0.5
_MOST = 2
_STILL = 0.1
_EXCHANGED = "are exchanged"


def check_odd_wheels(recordings: Sequence[Recording], nominal: Nominal) -> None:
    """Refuse recordings in which `odd_wheels` finds a wheel that is wrong; raises `DataError`."""
    if not recordings or not (odd := odd_wheels(recordings, nominal.geometry)):
        return
    names = [one.sources[0] if one.sources else one.name for one in recordings]
    likewise = f" ({len(names) - 1} more recordings likewise)" if len(names) > 1 else ""
    raise DataError(
        names[0],
        "; ".join(odd) + likewise,
        expected="columns of each wheel in the order FL, BL, BR, FR; phi grows as it rolls along delta",
        remedy="correct that column in the file",
    )


def alike(recordings: Sequence[Recording], nominal: Nominal) -> list[Recording]:
    """The recordings, two at least, in which the same wheels are exchanged: then it is no single file."""
    found = {k: " ".join(odd_wheels([one], nominal.geometry)) for k, one in enumerate(recordings)}
    same = Counter(said for said in found.values() if _EXCHANGED in said)
    most = max(same, key=lambda said: same[said], default="")
    return [recordings[k] for k, said in found.items() if said == most] if same[most] > 1 else []


def odd_wheels(recordings: Sequence[Recording], geometry: WheelGeometry) -> list[str]:
    """One sentence for each wheel, of two at most, that alone misses more than 0.3 of its true way.

    The others miss less than 0.2, and undoing one cause makes it agree. Empty where more wheels are off: then
    the cause is common to them.

    Args:
        recordings: recordings of one robot.
        geometry: wheels that the ways are computed for.
    """
    pairs = [ways(one, geometry) for one in recordings]
    rolled, moved = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
    share = missed(rolled, moved)
    odd = np.flatnonzero(share > _ODD).tolist()
    if not 0 < len(odd) <= _MOST or np.count_nonzero(share < _AGREES) + len(odd) < len(WHEELS):
        return []
    if len(odd) == _MOST and np.all(missed(rolled[:, odd[::-1]], moved[:, odd]) < _AGREES):
        one, other = odd
        columns = f"{_columns(one)} for {_columns(other)}"
        return [f"the {WHEELS[one]} and {WHEELS[other]} wheels {_EXCHANGED} ({columns})"]
    causes = {i: _causes(i, rolled[:, i], moved[:, i], _EXPLAINED * share[i]) for i in odd}
    return [
        f"the {WHEELS[i]} wheel ({_columns(i)}) alone misses {100.0 * share[i]:.0f} % of its way by ground "
        f"truth, and would agree if {', or if '.join(found)}"
        for i, found in causes.items()
        if found
    ]


def ways(one: Recording, geometry: WheelGeometry) -> tuple[Complexes, Complexes]:
    """Ways (s, 4), m, of each wheel in stretches in which they roll: by its angles, and by ground truth."""
    drive = Drive(one.t_s, one.wheel_angle_rad, one.steering_rad, one.truth_t_s, one.truth_pose)
    edges_s = drive.edges_s()
    rolled = by_wheels(drive, edges_s, geometry)
    moved = by_truth(drive.truth_t_s, drive.pose, edges_s, geometry)
    mask = rolling(rolled, moved, drive.known(edges_s), geometry)
    return rolled[mask], moved[mask]


def _columns(wheel: int) -> str:
    return f"phi{wheel + 1}, delta{wheel + 1}"


def _causes(wheel: int, rolled: Complexes, moved: Complexes, least: float) -> list[str]:
    """Changes of the wheel's columns that make it agree; several where no drive tells them apart."""
    phi, delta = f"phi{wheel + 1}", f"delta{wheel + 1}"
    if np.abs(rolled).sum() < _STILL * np.abs(moved).sum():
        return [f"{phi}, which hardly changes, followed its wheel"]
    turn = float(np.angle(np.vdot(rolled, moved)))
    scale = float(np.abs(moved).sum() / np.abs(rolled).sum())
    signs = {
        f"{phi} had the other sign or {delta} were half a turn further": -rolled,
        f"{delta} had the other sign": rolled.conj(),
        f"{phi} and {delta} both had the other sign": -rolled.conj(),
    }
    others = {
        f"{delta} were {np.degrees(turn):.0f} deg further": rolled * np.exp(1j * turn),
        f"{phi} grew by {scale:.3g} times as much": rolled * scale,
    }
    for changes in (signs, others):
        found = {words: _missed(way, moved) for words, way in changes.items()}
        agree = [words for words, left in found.items() if left < min(_AGREES, least)]
        if agree:
            return agree
    return []


def _missed(rolled: Complexes, moved: Complexes) -> float:
    left: Array = missed(rolled[:, None], moved[:, None])
    return float(left[0])
