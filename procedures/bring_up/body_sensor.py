"""Checks the sensor that shows how the body moves by jogs of single wheels: its turns, its axes, its place.

A camera that is turned about the vertical shows the right gravity. It shows no turn, or the opposite one, and
all that is measured by it would be blamed on drives and steering. The gyro shows the same turns.
"""

import numpy as np

from hil.core.geometry import Array
from hil.loop.checks.wrong_parameter import explained_by_lever
from hil.procedures.bring_up.jogs import DriveJogs

_KEYS = {"tracker": "tracker.mount_rotation_wxyz", "mocap": "mocap.body"}
_CALLED = {"tracker": "the camera", "mocap": "motion capture"}
_SAME = (0.6, 1.6)
"""Turn of good sensors over that of the gyro, in turns of milliradians."""
_TURNS_RAD, _MISSING = 0.001, 0.3
"""Turns that count; and share of them up to which they are about another axis."""
_ALIKE, _APART_RAD, _ROTATED_RAD = 0.55, 0.4, 0.6
"""Cosine from which turns are those of the wheels: 0.69 on a floor, and 0.35 with reversed steering; angle by
which two rotations may differ; and that from which pushes look like those of other wheels."""
_LEVER_M = 0.08
"""Difference of a place on the body from which jogs show it: slipping wheels alone give 0.055 m."""


def wrong_turns(source: str, straight: DriveJogs, across: DriveJogs) -> str:
    """Return why the turns by a sensor of the body cannot be right, with keys; empty if they may be.

    Gyro, sensor and wheels each show the turns. Of these the one that two others contradict is wrong.

    Args:
        source: the sensor, `mocap` or `tracker`.
        straight: jogs with the wheels along the body.
        across: jogs with the wheels across it.
    """
    seen = np.concatenate([straight.moved[:, 2], across.moved[:, 2]])
    felt = np.concatenate([straight.felt_rad, across.felt_rad])
    if not np.isfinite([seen, felt]).all() or max(_size(seen), _size(felt)) < _TURNS_RAD:
        return ""  # a jog that was not seen says nothing of all others
    if _SAME[0] * _size(felt) ** 2 < seen @ felt < _SAME[1] * _size(felt) ** 2:
        return ""
    pushed = straight.expected[:, 2]
    wheels = {name: float(turn[:4] @ pushed) for name, turn in ((source, seen), ("imu", felt))}
    wrong = min(wheels, key=lambda name: wheels[name])
    if wrong == "imu":  # judged by the turn of the body
        return ""
    share = seen @ felt / _size(felt) ** 2
    missing = "mocap.up_axis and " if source == "mocap" and abs(share) < _MISSING else ""
    return (
        f"{_CALLED[source]} sees {share:.2f} of the turns that the gyro sees, and the wheels agree with the "
        f"gyro: look at {missing}{_KEYS[source]}, which turns its axes."
    )


def wrong_axes(source: str, straight: DriveJogs, across: DriveJogs) -> str:
    """Return why the pushes by a sensor of the body cannot be blamed on the wheels, with its key; else empty.

    A sensor that is turned about the vertical shows the right gravity and the right turns of the body. It
    rotates all pushes alike, and its place on the body, which then seems to move with each turn. Wheels that
    are steered or driven the wrong way turn the body otherwise, too.

    Args:
        source: the sensor, `mocap` or `tracker`.
        straight: jogs with the wheels along the body.
        across: jogs with the wheels across it.
    """
    rounds = (straight, across)
    if not all(np.isfinite(one.moved).all() for one in rounds):
        return ""
    felt = [one.felt_rad if np.isfinite(one.felt_rad).all() else one.moved[:, 2] for one in rounds]
    (along, side), (ahead, left) = felt, (one.expected[:, 2] for one in rounds)
    size = _size(np.concatenate(felt)) * _size(np.concatenate([ahead, left]))
    by_wheels = complex(along @ ahead + side @ left, along @ left - side @ ahead)  # its angle: that of wheels
    if _size(np.concatenate(felt)) < _TURNS_RAD or abs(by_wheels) < _ALIKE * size:
        return ""
    rotated = [_rotation(one, turn) for one, turn in zip(rounds, felt, strict=True)]
    both = sum(rotated)
    apart = max(abs(np.angle(one / both)) for one in rotated) if both else np.inf
    rotated_rad = float(np.angle(both))
    if max(apart, abs(np.angle(by_wheels))) > _APART_RAD or abs(rotated_rad) < _ROTATED_RAD:
        return ""
    return (
        f"{_CALLED[source]} sees all pushes of the wheels rotated by {np.degrees(rotated_rad):+.0f} deg, and "
        f"the turns fit the wheels: look at {_KEYS[source]}, which turns its axes."
    )


def _rotation(jogs: DriveJogs, turns: Array) -> complex:
    """Complex factor from expected to seen pushes; turns (4,) may add what a wrong place makes of them."""
    pushed, seen = (rows[:, 0] + 1j * rows[:, 1] for rows in (jogs.expected, jogs.moved))
    known = np.stack([pushed, turns.astype(np.complex128)], axis=1)
    return complex(np.linalg.lstsq(known, seen, rcond=None)[0][0])


def wrong_place(source: str, straight: DriveJogs, across: DriveJogs) -> str:
    """Return how far the place of a sensor on the body seems to be off, with its key; empty for not.

    A wheel pushes the body along its own heading; what a turn adds beside that is the sensor's place.
    """
    turns = straight.moved[:, 2], across.moved[:, 2]
    forwards_m = -float(straight.moved[:, 1] @ turns[0]) / max(_size(turns[0]) ** 2, 1e-12)
    left_m = float(across.moved[:, 0] @ turns[1]) / max(_size(turns[1]) ** 2, 1e-12)
    off_m = float(np.hypot(forwards_m, left_m))
    found = explained_by_lever(source, off_m) if off_m > _LEVER_M else None
    if found is None:
        return ""
    return (
        f"{_CALLED[source]} sees turns move the body {1e3 * forwards_m:+.0f} mm forwards and "
        f"{1e3 * left_m:+.0f} mm to the left of its centre: look at {found.key}, {found.text}, first."
    )


def _size(values: Array) -> float:
    return float(np.linalg.norm(values))
