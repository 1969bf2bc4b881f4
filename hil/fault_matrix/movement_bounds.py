"""Bounds for each class of faults: how far the robot may move, and whether its hold may be lost.

The class follows from the faulty device and from what the fault removes, so that a fault is not judged by the
weaker bounds of another one.
"""

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace

from hil.bench.hold.adhesion_force import MEASURES
from hil.core.device import DeviceKind
from hil.core.registry import kinds
from hil.core.signals import SERVOS
from hil.fault_matrix.cases import Cell

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
MOST_ASTRAY_M = 0.02
"""Largest true distance from the reference of a driven robot: a wrong sensor is found within 15 mm."""
EFFECT_M, SAGGED_N = 0.003, (36.0, 13.0)
"""A fault had an effect beyond this true distance from a run without it, or below these forces of fan and
propellers: four fifths of the fan's 45 N, and what the propellers must push with then. Noise that is drawn
anew makes a distance of up to 2.4 mm.
"""
PASS_M, FIGURE_M = 0.01, 0.005
"""Distance from the goal with which a drive counts as good, and largest error of a figure without a mark."""
MOST_NAMED = 4
"""Largest number of kinds of devices that one stop may name: of two that disagree, and two that press."""
LEAST_ADHESION_N, LEAST_THRUST_N = 21.0, 8.0
"""Below the first force the shipped robot slides while its propellers push; below the second it slides even
while its fan presses as hard as it can.
"""
_NO_COMMANDS = ("bus_off", "unplug", "baud_mismatch", "silent")
_ON_CAN = ("drop", "corrupt", "truncate", "garbage", "intermittent")
_TAKE_FORCE: Mapping[str, Collection[str]] = {
    "adhesion": ("off", "brownout", "reset", "adhesion_loss", *_NO_COMMANDS, *_ON_CAN),
    "thrust": (
        *("off", "brownout", "reset", *_NO_COMMANDS),
        *("garbage", "intermittent", "slow", "drop", "corrupt", "truncate"),
    ),
}
"""Faults by which a device itself stops pressing: it has no power, restarts, or receives no commands. A wrong
report is none: the bench does what follows.
"""
SEES = ("tracker", "mocap")
"""Kinds of devices of the shipped bench that measure a slide."""
_DIRECTION = re.compile(r"direction=(\w+)")
_JOINT = re.compile(r"servo\.(\w+)")
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
    "what holds the robot", "5 mm; a fall only where the device itself stops pressing, and never HELD"
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
    """Whether a faulty device has itself stopped pressing, and the robot cannot be held without it."""
    short = {"adhesion": adhesion_n < LEAST_ADHESION_N, "thrust": thrust_n < LEAST_THRUST_N}
    parts = [(kind_of(device).name, fault, spec) for device, fault, spec in _parts(cell)]
    return any(
        short.get(kind, False) and fault in _TAKE_FORCE.get(kind, ()) and _reaches(kind, fault, spec)
        for kind, fault, spec in parts
    )


def _reaches(kind: str, fault: str, spec: str) -> bool:
    """Whether a fault of a wire stops what is sent towards the device."""
    given, without = _DIRECTION.search(spec), fault == "silent" or (kind == "adhesion" and fault in _ON_CAN)
    return (given[1] if given else "in" if without else "both") != "in"


def faulty_joints(cell: Cell) -> frozenset[str]:
    """Return the names of single servos with a fault, as `SERVOS` has them."""
    found = (_JOINT.fullmatch(device) for device in cell.device.split("+"))
    names = (match[1] for match in found if match)
    return frozenset(SERVOS[int(name) - 1] if name.isdigit() else name for name in names)


def away_joints(cell: Cell) -> frozenset[str]:
    """Return the names of single servos without supply or bus until the end."""
    away = [d for d, fault, spec in _parts(cell) if _class_of(d, fault) is ONE_SERVO and _lasts(spec)]
    return faulty_joints(replace(cell, device="+".join(away))) if away else frozenset()


def crept_most_m(cell: Cell, looked_s: float) -> float:
    """Return how far a robot that is NOT HELD may move, m, while it is observed after the close."""
    return farthest_m(cell, looked_s, looked_s + WATCHED_S)


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
