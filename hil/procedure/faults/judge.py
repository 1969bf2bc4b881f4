"""Judges one cell: robot held, suspect named, recovery, recording, error of the estimate.

The verdict uses data: the kinds of devices that a stop or an event names as suspects, and the true motion of
the robot. Message texts are shown but not evaluated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hil.procedure.faults.cases import Cell
from hil.procedure.faults.movement_bounds import (
    MOST_OFF_M,
    SIGMAS,
    SLACK_M,
    farthest_m,
    faulty_kinds,
    hold_unconfirmable,
    kind_of,
    let_go,
    still_m,
)
from hil.procedure.faults.observation import Ended, Seen


@dataclass(frozen=True)
class Measured:
    """Measured values of a cell for the page; distances in m.

    Attributes:
        moved_m: motion after the stop, until the bench reported how the robot is held.
        most_m: upper limit of this motion.
        crept_m: motion from then on.
        off_m: error of the estimate, if the run reached its end.
        fell: whether the robot fell.
    """

    moved_m: float = 0.0
    most_m: float = 0.0
    crept_m: float = 0.0
    off_m: float = 0.0
    fell: bool = False


@dataclass(frozen=True)
class CellVerdict:
    """Verdict of one cell.

    Attributes:
        cell: the cell.
        why: reasons for failure; empty for a cell that passes.
        ended: `went on`, or the reason of the stop.
        reported: whether stop or events name the faulty device; of several, all of them.
        held: final report of the bench on how the robot is held.
        others: kinds of devices that were named as suspects without a faulty one among them.
        measured: measured values.
        opened: whether the bench opened.
    """

    cell: Cell
    why: tuple[str, ...]
    ended: str
    reported: bool
    held: str
    others: tuple[str, ...] = ()
    measured: Measured = Measured()
    opened: bool = True


def lost(cell: Cell, reason: str) -> CellVerdict:
    """Return the verdict of a cell whose worker died."""
    return CellVerdict(cell, (reason,), "lost", False, "")


def judge(cell: Cell, seen: Seen) -> CellVerdict:
    """Return the verdict of a cell from its observations."""
    by = faulty_kinds(cell)
    evidence = [_kinds(names) for names in (*seen.events, *(e.suspects for e in _ends(seen)))]
    others = {name for one in evidence if not one & by for name in one}
    ends = _ends(seen)
    measured = Measured(
        moved_m=seen.moved_m,
        most_m=farthest_m(cell, seen.stopped_s, seen.looked_s),
        crept_m=seen.crept_m,
        off_m=float(np.hypot(*seen.off_m)) if seen.cycles and not ends else 0.0,
        fell=seen.fallen,
    )
    return CellVerdict(
        cell,
        why=tuple(_wrong(cell, seen, measured)),
        ended=ends[0].reason if ends else "went on",
        reported=by <= {name for one in evidence for name in one},
        held=seen.state,
        others=tuple(sorted(others)),
        measured=measured,
        opened=seen.cycles > 0,
    )


def _ends(seen: Seen) -> list[Ended]:
    """Return what ended the drive, and the error of opening or closing."""
    return [end for end in (seen.stop, seen.error) if end is not None]


def _kinds(names: tuple[str, ...]) -> frozenset[str]:
    """Return the kinds of the named devices; `supervisor` and `outside` are left out."""
    return frozenset(kind_of(name).name for name in names if name not in ("supervisor", "outside"))


def _wrong(cell: Cell, seen: Seen, measured: Measured) -> Iterator[str]:
    """Yield every violated promise as text."""
    if seen.foreign:
        yield f"an exception of another kind: {seen.foreign}"
    if seen.unreadable:
        yield f"the recording: {seen.unreadable}"
    for end in _ends(seen):
        if not _kinds(end.suspects) & faulty_kinds(cell):
            suspects = ", ".join(sorted(_kinds(end.suspects))) or "no device"
            yield f"{end.reason} names {suspects} and not the faulty device: {end.text}"
    yield from _wrong_of_hold(cell, seen, measured)
    yield from _wrong_of_estimate(cell, seen)


def _wrong_of_hold(cell: Cell, seen: Seen, measured: Measured) -> Iterator[str]:
    """Yield every violated promise about the hold of the robot."""
    gone, moved_mm, crept_mm = _gone(cell, seen), 1e3 * seen.moved_m, 1e3 * seen.crept_m
    if seen.fallen and not gone:
        yield "the robot fell, and the faulty device had not let it go"
    if seen.state == "HELD" and (seen.fallen or not seen.crept_m <= still_m(cell)):
        yield f"said to be held, and moved by {crept_mm:.1f} mm{', and it fell' if seen.fallen else ''}"
    if seen.cycles and seen.state not in ("HELD", "not needed") and not (gone or hold_unconfirmable(cell)):
        yield f"not held: {seen.held.why if seen.held is not None else 'no report'}"
    if not gone and not seen.moved_m <= measured.most_m:
        yield f"moved by {moved_mm:.1f} mm after the stop, more than {1e3 * measured.most_m:.1f} mm"
    if not seen.cycles and not gone and not seen.crept_m <= measured.most_m:
        yield f"did not open, and moved by {crept_mm:.1f} mm, more than {1e3 * measured.most_m:.1f} mm"


def _wrong_of_estimate(cell: Cell, seen: Seen) -> Iterator[str]:
    """Yield a violated promise about the estimate, if the run reached its end."""
    if not seen.cycles or _ends(seen) or (seen.state != "HELD" and _gone(cell, seen)):
        return
    off_m, sigma_m = float(np.hypot(*seen.off_m)), float(np.hypot(*seen.sigma_m))
    if not (np.all(seen.off_m <= SIGMAS * seen.sigma_m + SLACK_M) and off_m <= MOST_OFF_M):
        yield (
            f"reached its end {1e3 * off_m:.0f} mm from its estimate, whose sigma is {1e3 * sigma_m:.0f} mm"
        )


def _gone(cell: Cell, seen: Seen) -> bool:
    """Whether the faulty device truly let the robot go."""
    return let_go(cell, seen.adhesion_n, seen.thrust_n)
