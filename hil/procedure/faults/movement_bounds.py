"""Bounds for each class of faults: how far the robot may move, and whether its hold may be lost.

The class follows from the faulty device and from what the fault removes, so that a fault is not judged by the
weaker bounds of another one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from hil.bench.hold.adhesion_force import MEASURES
from hil.core.device import DeviceKind
from hil.core.registry import kinds
from hil.procedure.faults.cases import Cell

FARTHEST_M, STILL_M = 0.005, 0.0005
"""Largest motion of a robot after its stop, and after it was reported HELD."""
SAGS_M = 0.005
"""Replaces `STILL_M` if a servo may fail again afterwards."""
LIMP_M_S, RESTART_S = 0.025, 0.4
"""Sliding speed of a robot whose servos have no torque, and the time until the torque is back."""
WATCHED_S = 5.0
"""Time for which the robot is observed after the bench has closed."""
SIGMAS, SLACK_M, MOST_OFF_M = 3.0, 0.005, 0.04
"""Largest error of the final estimate: SIGMAS times its sigma plus SLACK_M, and at most MOST_OFF_M."""
LEAST_ADHESION_N, LEAST_THRUST_N = 21.0, 13.0
"""Below these forces, of the fan's 45 N and the propellers' 22 N, the shipped robot slides down its wall."""
SEES = ("tracker", "mocap")
"""Kinds of devices of the shipped bench that measure a slide."""
_LETS_GO = (
    "off",
    "brownout",
    "reset",
    "unplug",
    "baud_mismatch",
    "drop",
    "corrupt",
    "truncate",
    "garbage",
    "intermittent",
    "silent",
    "pieces",
    "slow",
)
"""Faults of servos that interrupt supply or bus, permanently or for a time, or delay the answers."""


@dataclass(frozen=True)
class FaultClass:
    """Faults that share the same bounds.

    Attributes:
        name: text in the page.
        promise: the bounds, as text in the page.
    """

    name: str
    promise: str


PRESSES = FaultClass(
    "what holds the robot",
    "5 mm, or, where fan or propellers truly give too little, a reported fall: never HELD",
)
TORQUE = FaultClass(
    "all servos without supply or bus",
    f"5 mm, and {1e3 * LIMP_M_S:.0f} mm/s until they are back, {RESTART_S:g} s after the fault; NOT HELD "
    "while they are away",
)
ONE_SERVO = FaultClass("one servo without supply or bus", "5 mm; NOT HELD while it is away")
OTHERS = FaultClass("all others", "5 mm, and HELD")
CLASSES = (PRESSES, TORQUE, ONE_SERVO, OTHERS)


def kind_of(device: str) -> DeviceKind:
    """Return the kind of a device by its fault name; the robot counts as the device that presses it on."""
    known = kinds()
    head = device.split(".", 1)[0]
    found = next((k for k in known.values() if head in (k.name, k.shown_as, *k.aliases)), None)
    found = found or next((k for k in known.values() if k.name.rstrip("s") == head), None)
    return found or known.get(head) or known["adhesion"]


def faulty_kinds(cell: Cell) -> frozenset[str]:
    """Return the kinds of the faulty devices."""
    return frozenset(kind_of(device).name for device in cell.device.split("+"))


def class_of(cell: Cell) -> FaultClass:
    """Return the fault class of a cell; of several faults the one with the weakest bounds."""
    found = {_class_of(device, fault) for device, fault, _ in _parts(cell)}
    return next(one for one in CLASSES if one in found)


def _class_of(device: str, fault: str) -> FaultClass:
    if kind_of(device).name in ("adhesion", "thrust"):
        return PRESSES
    if kind_of(device).name == "servos" and fault in _LETS_GO:
        return TORQUE if device == "servos" else ONE_SERVO
    return OTHERS


def let_go(cell: Cell, adhesion_n: float, thrust_n: float) -> bool:
    """Whether the true force of a faulty holding device was too low."""
    least = {"adhesion": adhesion_n < LEAST_ADHESION_N, "thrust": thrust_n < LEAST_THRUST_N}
    return any(least.get(kind, False) for kind in faulty_kinds(cell))


def farthest_m(cell: Cell, stopped_s: float, looked_s: float) -> float:
    """Return how far the robot may move, m, from its stop to the end of the hold check (world times, s)."""
    limp_s = 0.0
    for device, fault, spec in _parts(cell):
        if _class_of(device, fault) is TORQUE:
            start_s, end_s = _interval_s(spec)
            limp_s += max(min(end_s + RESTART_S, looked_s) - max(start_s, stopped_s), 0.0)
    return FARTHEST_M + LIMP_M_S * limp_s


def still_m(cell: Cell) -> float:
    """Return how far a robot may move, m, after it was reported HELD."""
    return SAGS_M if _is_without(cell) else STILL_M


def hold_unconfirmable(cell: Cell) -> bool:
    """Whether the hold cannot be confirmed until the end: servos, force or slide cannot be measured."""
    return _is_without(cell) or _is_unmeasured(cell) or _is_unseen(cell)


def _is_without(cell: Cell) -> bool:
    return any(
        _lasts(spec)
        for device, fault, spec in _parts(cell)
        if _class_of(device, fault) in (TORQUE, ONE_SERVO)
    )


def _is_unmeasured(cell: Cell) -> bool:
    """Whether all devices that measure the force on the wall are faulty until the end."""
    return {device for device, _, spec in _parts(cell) if _lasts(spec)}.issuperset(MEASURES)


def _is_unseen(cell: Cell) -> bool:
    """Whether all devices that measure a slide had a fault, at least one of them until the end.

    A sensor that had wrong values for a time is not trusted afterwards.
    """
    seeing: Mapping[str, bool] = {d: _lasts(spec) for d, _, spec in _parts(cell) if d in SEES}
    return len(seeing) == len(SEES) and any(seeing.values())


def _lasts(spec: str) -> bool:
    """Whether a fault lasts until the end."""
    return "+" not in spec.split(",", 1)[0]


def _interval_s(spec: str) -> tuple[float, float]:
    """Return start and end of a fault, s; the end is `inf` for a permanent fault."""
    _, _, when = spec.split(",", 1)[0].partition("@")
    start, _, lasts = when.partition("+")
    start_s = float(start or 0.0)
    return start_s, start_s + float(lasts or "inf")


def _parts(cell: Cell) -> Iterator[tuple[str, str, str]]:
    """Return device, kind and spec of each fault of a cell."""
    return zip(cell.device.split("+"), cell.fault.split("+"), cell.specs, strict=True)
