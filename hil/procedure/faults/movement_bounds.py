"""What is promised of a robot by the class of the fault that strikes: how far it may move, what may be lost.

The class goes by the device that was struck and by what the fault takes away, so that no fault is excused by
what another one would have done.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from hil.bench.hold.adhesion_force import MEASURES
from hil.core.device import DeviceKind
from hil.core.registry import kinds
from hil.procedure.faults.cases import Cell

FARTHEST_M, STILL_M = 0.005, 0.0005
"""That a robot may move after its stop, and once it is said to be held."""
SAGS_M = 0.005
"""In place of `STILL_M` where a servo may fail again after that."""
LIMP_M_S, RESTART_S = 0.025, 0.4
"""Speed at which a robot slides down whose servos have no torque, and how long they take to come back."""
WATCHED_S = 5.0
"""For which a robot is watched after the bench has closed."""
SIGMAS, SLACK_M, MOST_OFF_M = 3.0, 0.005, 0.04
"""By which the estimate of a run that ends well may be wrong: by its sigmas, and whatever it says of them."""
LEAST_ADHESION_N, LEAST_THRUST_N = 21.0, 13.0
"""Below them the shipped robot slides down its wall: of the fan's 45 N, and of the propellers' 22 N."""
SEES = ("tracker", "mocap")
"""Kinds of the shipped bench that see a slide."""
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
    "slow",
)
"""Faults of servos that take supply or bus, wholly or for a while, or answer too late."""


@dataclass(frozen=True)
class FaultClass:
    """Faults of which the same is promised.

    Attributes:
        name: in the page.
        promise: in the page.
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
    """The kind of a device by its fault name; the robot itself is named by what presses it on."""
    known = kinds()
    head = device.split(".", 1)[0]
    found = next((k for k in known.values() if head in (k.name, k.shown_as, *k.aliases)), None)
    found = found or next((k for k in known.values() if k.name.rstrip("s") == head), None)
    return found or known.get(head) or known["adhesion"]


def struck(cell: Cell) -> frozenset[str]:
    """Kinds of devices that are struck."""
    return frozenset(kind_of(device).name for device in cell.device.split("+"))


def class_of(cell: Cell) -> FaultClass:
    """The class of a cell; of several faults that of which least is promised."""
    found = {_class_of(device, fault) for device, fault, _ in _parts(cell)}
    return next(one for one in CLASSES if one in found)


def _class_of(device: str, fault: str) -> FaultClass:
    if kind_of(device).name in ("adhesion", "thrust"):
        return PRESSES
    if kind_of(device).name == "servos" and fault in _LETS_GO:
        return TORQUE if device == "servos" else ONE_SERVO
    return OTHERS


def let_go(cell: Cell, adhesion_n: float, thrust_n: float) -> bool:
    """Whether what a struck device holds the robot with was truly too little."""
    least = {"adhesion": adhesion_n < LEAST_ADHESION_N, "thrust": thrust_n < LEAST_THRUST_N}
    return any(least.get(kind, False) for kind in struck(cell))


def farthest_m(cell: Cell, stopped_s: float, looked_s: float) -> float:
    """How far the robot may move between its stop and the end of the look at it (times in s of the world)."""
    limp_s = 0.0
    for device, fault, spec in _parts(cell):
        if _class_of(device, fault) is TORQUE:
            start_s, end_s = _interval_s(spec)
            limp_s += max(min(end_s + RESTART_S, looked_s) - max(start_s, stopped_s), 0.0)
    return FARTHEST_M + LIMP_M_S * limp_s


def still_m(cell: Cell) -> float:
    """How far a robot may move that was said to be held."""
    return SAGS_M if _is_without(cell) else STILL_M


def need_not_be_held(cell: Cell) -> bool:
    """Whether nothing can say that the robot is held, to the end: of servos, of its force, or of a slide."""
    return _is_without(cell) or _is_unmeasured(cell) or _is_unseen(cell)


def _is_without(cell: Cell) -> bool:
    return any(
        _lasts(spec)
        for device, fault, spec in _parts(cell)
        if _class_of(device, fault) in (TORQUE, ONE_SERVO)
    )


def _is_unmeasured(cell: Cell) -> bool:
    """Whether all that measure the force on the wall are at fault to the end."""
    return {device for device, _, spec in _parts(cell) if _lasts(spec)}.issuperset(MEASURES)


def _is_unseen(cell: Cell) -> bool:
    """Whether all that see a slide were at fault, one of them to the end.

    A sensor with wrong values for a while is in doubt from then on.
    """
    seeing: Mapping[str, bool] = {d: _lasts(spec) for d, _, spec in _parts(cell) if d in SEES}
    return len(seeing) == len(SEES) and any(seeing.values())


def _lasts(spec: str) -> bool:
    """Whether a fault lasts to the end."""
    return "+" not in spec.split(",", 1)[0]


def _interval_s(spec: str) -> tuple[float, float]:
    """When a fault begins and ends; `inf` for one that lasts."""
    _, _, when = spec.split(",", 1)[0].partition("@")
    start, _, lasts = when.partition("+")
    start_s = float(start or 0.0)
    return start_s, start_s + float(lasts or "inf")


def _parts(cell: Cell) -> Iterator[tuple[str, str, str]]:
    """Device, kind and spec of each fault of a cell."""
    return zip(cell.device.split("+"), cell.fault.split("+"), cell.specs, strict=True)
