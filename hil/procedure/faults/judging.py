"""What is right of one cell, and what is not: held, named, recovered, recorded, honest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from hil.bench import Held
from hil.bench.pressing import MEASURES
from hil.procedure.faults.cells import Cell
from hil.vocabulary.geometry import Array
from hil.vocabulary.kinds import DeviceKind, kinds

FARTHEST_M, STILL_M = 0.005, 0.0005
"""That a robot may move after its stop, and within a look at it that is said to be held."""
SIGMAS, SLACK_M = 3.0, 0.005
"""By which the estimate of a run that ends well may be wrong."""
SEES = ("tracker", "mocap")
"""Devices of the shipped bench that see a slide."""
LEAST_ADHESION_N = 21.0
"""Below it the shipped robot slides down its wall whatever anybody does."""
_LETS_GO = ("off", "brownout", "reset", "unplug", "baud_mismatch", "drop", "corrupt", "truncate", "garbage",
            "intermittent", "slow")  # fmt: skip
"""Faults of servos that take supply or bus, wholly or for a while, or answer when nobody listens any more."""
LEAST_THRUST_N = 13.0
"""Of 22: with less of the propellers' thrust it slides, whatever its fan does."""


@dataclass
class Seen:
    """What was seen of a run.

    Attributes:
        cycles: how many there were.
        events: source and message of each.
        stop: what ended the drive; empty where it came to its end.
        error: what opening and closing raised; empty for nothing.
        foreign: an exception that is none of this project's.
        unreadable: what is wrong with the recording.
        off_m, sigma_m: (2,) true error of the last estimate, and its standard deviation.
        said, why: what the bench said of the robot after looking after it.
        moved_m, crept_m: true way from the stop until then, and in the next moments.
        fallen: the true robot.
        adhesion_n, thrust_n: least that truly held it at any time.
        held: the bench's last word.
    """

    cycles: int = 0
    events: list[tuple[str, str]] = field(default_factory=list)
    stop: str = ""
    error: str = ""
    foreign: str = ""
    unreadable: str = ""
    off_m: Array = field(default_factory=lambda: np.zeros(2))
    sigma_m: Array = field(default_factory=lambda: np.zeros(2))
    said: str = ""
    why: str = ""
    moved_m: float = 0.0
    crept_m: float = 0.0
    fallen: bool = False
    adhesion_n: float = 1e3
    thrust_n: float = 1e3
    held: Held | None = None


@dataclass(frozen=True)
class CellVerdict:
    """Of one cell.

    Attributes:
        cell: which.
        why: what is wrong; empty for a cell that passes.
        ended: `went on`, or the reason of the stop.
        told: whether messages or events name the device; of several all of them.
        held: what the bench said of the robot.
    """

    cell: Cell
    why: tuple[str, ...]
    ended: str
    told: bool
    held: str


def lost(cell: Cell, reason: str) -> CellVerdict:
    """Of a cell whose worker died."""
    return CellVerdict(cell, (reason,), "lost", False, "")


def judge(cell: Cell, seen: Seen) -> CellVerdict:
    """The verdict on what was seen of a cell."""
    named = [_is_named(device, seen) for device in cell.device.split("+")]
    ended = "went on"
    if seen.stop or seen.error:
        text = (seen.stop or seen.error).split("(", 1)
        ended = text[1].split(")", 1)[0] if "robot stopped" in text[0] and len(text) > 1 else "device error"
    wrong = tuple(_wrong(cell, seen, any(named)))
    return CellVerdict(cell, wrong, ended, all(named), seen.said or _state(seen))


def _state(seen: Seen) -> str:
    return "" if seen.held is None else seen.held.state


def _wrong(cell: Cell, seen: Seen, named: bool) -> Iterator[str]:
    """Everything that is not as promised; `named`: whether one of those that were struck is named."""
    if seen.foreign:
        yield f"an exception of another kind: {seen.foreign}"
    if seen.unreadable:
        yield f"the recording: {seen.unreadable}"
    if (seen.stop or seen.error) and not named:
        yield f"the device is not named: {seen.stop or seen.error}"
    dropped = seen.adhesion_n < LEAST_ADHESION_N or seen.thrust_n < LEAST_THRUST_N
    if seen.fallen and not dropped:
        yield "the robot fell although fan and propellers held it"
    noticed = seen.held is not None and seen.held.state != "HELD"
    still_m = FARTHEST_M if _is_without(cell) else STILL_M  # a servo that fails again behind the look sags
    if seen.said == "HELD" and seen.crept_m > still_m and not (dropped and noticed):
        yield f"said to be held, and moved by {1e3 * seen.crept_m:.1f} mm"
    excused = dropped or seen.fallen or _is_without(cell) or _is_unmeasured(cell) or _is_unseen(cell)
    if seen.said == "NOT HELD" and not excused:
        yield f"not held: {seen.why}"
    if seen.moved_m > FARTHEST_M and not (dropped or seen.fallen or _takes_servos(cell)):
        yield f"moved by {1e3 * seen.moved_m:.1f} mm after the stop"
    wrong = bool(np.any(seen.off_m > SIGMAS * seen.sigma_m + SLACK_M))
    if wrong and seen.cycles and not (seen.stop or seen.error or seen.said == "NOT HELD"):
        yield (
            f"went on to its end {1e3 * float(np.hypot(*seen.off_m)):.0f} mm beside its estimate, which says "
            f"{1e3 * float(np.hypot(*seen.sigma_m)):.0f} mm"
        )


def _takes_servos(cell: Cell) -> bool:
    """Whether servos lose supply or bus at all."""
    return bool(_that_let_go(cell))


def _is_without(cell: Cell) -> bool:
    """Whether servos lack supply or bus to the end: then nobody can say that the robot is held."""
    return any(map(_lasts, _that_let_go(cell)))


def _is_unmeasured(cell: Cell) -> bool:
    """Whether all that measure the force on the wall are at fault to the end: nobody knows if it holds."""
    struck = {device for device, _, spec in _parts(cell) if _lasts(spec)}
    return struck.issuperset(MEASURES)


def _is_unseen(cell: Cell) -> bool:
    """Whether all that see a slide were at fault, one of them to the end: nobody knows if propellers push.

    What told nonsense for a while is in doubt from then on.
    """
    struck = {device: _lasts(spec) for device, _, spec in _parts(cell) if device in SEES}
    return len(struck) == len(SEES) and any(struck.values())


def _lasts(spec: str) -> bool:
    """Whether a fault lasts to the end."""
    return "+" not in spec.split(",", 1)[0]


def _that_let_go(cell: Cell) -> list[str]:
    """Faults of a cell that take supply or bus from servos, as specs."""
    return [s for device, fault, s in _parts(cell) if device.startswith("servo") and fault in _LETS_GO]


def _parts(cell: Cell) -> Iterator[tuple[str, str, str]]:
    """Device, kind and spec of each fault of a cell."""
    return zip(cell.device.split("+"), cell.fault.split("+"), cell.specs, strict=True)


def _is_named(device: str, seen: Seen) -> bool:
    """Whether an event, the stop or the last word is about a device, or about what it does to the robot."""
    kind = kind_of(device)
    if any(source == kind.name for source, _ in seen.events):
        return True
    why = "" if seen.said == "HELD" else seen.why
    said = " ".join((*(m for _, m in seen.events), seen.stop, seen.error, why)).lower()
    words = {kind.name, kind.noun.lower(), kind.shown_as, *kind.aliases}
    return any(word in said or word.rstrip("s") in said for word in words)


def kind_of(device: str) -> DeviceKind:
    """The kind of a device by its fault name; the robot itself is named by what presses it on."""
    known = kinds()
    head = device.split(".", 1)[0]
    found = next((k for k in known.values() if head in (k.name, k.shown_as, *k.aliases)), None)
    found = found or next((k for k in known.values() if k.name.rstrip("s") == head), None)
    return found or known["adhesion"]
