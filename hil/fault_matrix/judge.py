"""Judges one cell: robot held, suspect named, recovery, recording, error of the estimate.

The verdict uses data: the kinds of devices that a stop or an event names as suspects, and the true motion of
the robot. Of message texts only the names of single servos are evaluated.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hil.core.signals import SERVOS
from hil.fault_matrix.cases import Cell
from hil.fault_matrix.movement_bounds import (
    EFFECT_M,
    FIGURE_M,
    LEAST_ADHESION_N,
    MOST_ASTRAY_M,
    MOST_NAMED,
    MOST_OFF_M,
    PASS_M,
    SAGGED_N,
    SIGMAS,
    SLACK_M,
    away_joints,
    crept_most_m,
    farthest_m,
    faulty_joints,
    faulty_kinds,
    hold_unconfirmable,
    kind_of,
    let_go,
    still_m,
)
from hil.fault_matrix.observation import Ended, Seen


@dataclass(frozen=True)
class Measured:
    """Measured values of a cell for the page; distances in m.

    Attributes:
        moved_m: motion after the stop, until the bench reported how the robot is held.
        most_m: upper limit of this motion.
        crept_m: motion from then on.
        off_m: error of the estimate, if the run reached its end.
        astray_m: largest distance from the reference during the drive.
        fell: True if the robot fell.
    """

    moved_m: float = 0.0
    most_m: float = 0.0
    crept_m: float = 0.0
    off_m: float = 0.0
    astray_m: float = 0.0
    fell: bool = False


@dataclass(frozen=True)
class CellVerdict:
    """Verdict of one cell.

    Attributes:
        cell: the cell.
        why: reasons for failure; empty for a cell that passes.
        ended: `went on`, or the reason of the stop.
        reported: True if stop or events name the faulty device; of several, all of them.
        held: final report of the bench on how the robot is held.
        others: kinds of devices that were named as suspects without a faulty one among them.
        measured: measured values.
        opened: True if the bench opened.
        told: events of warning and above, a line each.
    """

    cell: Cell
    why: tuple[str, ...]
    ended: str
    reported: bool
    held: str
    others: tuple[str, ...] = ()
    measured: Measured = Measured()
    opened: bool = True
    told: tuple[str, ...] = ()


def lost(cell: Cell, reason: str) -> CellVerdict:
    """Return the verdict of a cell whose worker died."""
    return CellVerdict(cell, (reason,), "lost", False, "")


def judge(cell: Cell, seen: Seen) -> CellVerdict:
    """Return the verdict of a cell from its observations."""
    by = faulty_kinds(cell)
    named = [*(one.suspects for one in seen.events), *(end.suspects for end in _ends(seen))]
    evidence = [_kinds(names) for names in named]
    others = {name for one in evidence if not one & by for name in one}
    ends = _ends(seen)
    measured = Measured(
        moved_m=seen.moved_m,
        most_m=farthest_m(cell, seen.stopped_s, seen.looked_s),
        crept_m=seen.crept_m,
        off_m=float(np.hypot(*seen.off_m)) if seen.cycles and not ends else 0.0,
        astray_m=seen.astray_m,
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
        told=tuple(one.text for one in seen.events),
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
    if seen.missed:
        yield f"{seen.missed} hit no message of its device"
    if seen.unreadable:
        yield f"the recording: {seen.unreadable}"
    yield from _wrong_of_names(cell, seen)
    yield from _wrong_of_hold(cell, seen, measured)
    yield from _wrong_of_path(cell, seen)
    yield from _wrong_of_estimate(cell, seen)


def _wrong_of_names(cell: Cell, seen: Seen) -> Iterator[str]:
    """Yield every violated promise about the devices that are named, also in a drive that went on."""
    by, ends = faulty_kinds(cell), _ends(seen)
    for end in ends:
        named = _kinds(end.suspects)
        if not named & by:
            suspects = ", ".join(sorted(named)) or "no device"
            yield f"{end.reason} names {suspects} and not the faulty device: {end.text}"
        elif len(named) > max(MOST_NAMED, len(by)):
            yield f"{end.reason} names {len(named)} kinds of devices: {', '.join(sorted(named))}"
        yield from _wrong_servo(faulty_joints(cell) if len(by) == 1 else frozenset(), end)
    held = "" if seen.held is None else seen.held.why
    if seen.state == "NOT HELD" and not away_joints(cell) <= _joints(held):
        yield f"NOT HELD does not name {', '.join(sorted(away_joints(cell)))}: {held}"
    if ends or not seen.cycles or seen.state == "NOT HELD" or not _had_effect(seen):
        return
    told = frozenset(name for one in seen.events for name in _kinds(one.suspects))
    if not told & by:
        what = f"only {', '.join(sorted(told))}" if told else "no device"
        yield f"went on and named {what}, though the fault took it {1e3 * seen.effect_m:.1f} mm off its way"


def _wrong_servo(faulty: frozenset[str], end: Ended) -> Iterator[str]:
    """Yield that a stop by single servos with a fault names others, or all of them."""
    named = _joints(end.text) | _joints(" ".join(end.suspects))
    if faulty and not named & faulty:
        others = ", ".join(sorted(named)) or "no servo"
        yield f"{end.reason} names {others} and not {', '.join(sorted(faulty))}: {end.text}"
    elif faulty and len(named) == len(SERVOS):
        yield f"{end.reason} names every servo"


def _joints(text: str) -> frozenset[str]:
    """Return the servos that a text names; a wheel without more is named by its drive."""
    return frozenset(name for name in SERVOS if name in text or name.replace("drive_", "wheel ") in text)


def _had_effect(seen: Seen) -> bool:
    """Whether the fault changed where the robot truly went, or what pressed it on its wall."""
    fan_n, propellers_n = SAGGED_N
    sagged = seen.on_wall and not (seen.adhesion_n >= fan_n and seen.thrust_n >= propellers_n)
    return sagged or not seen.effect_m <= EFFECT_M


def _wrong_of_hold(cell: Cell, seen: Seen, measured: Measured) -> Iterator[str]:
    """Yield every violated promise about the hold of the robot."""
    gone, moved_mm, crept_mm = _gone(cell, seen), 1e3 * seen.moved_m, 1e3 * seen.crept_m
    if seen.fallen and not gone:
        yield "the robot fell, and the faulty device had not let it go"
    if seen.state == "HELD" and (seen.fallen or not seen.crept_m <= still_m(cell)):
        yield f"said to be held, and moved by {crept_mm:.1f} mm{', and it fell' if seen.fallen else ''}"
    if seen.state == "HELD" and seen.on_wall and not seen.left_adhesion_n >= LEAST_ADHESION_N:
        yield f"said to be held, with {seen.left_adhesion_n:.1f} N of {LEAST_ADHESION_N:g} N at least"
    if seen.state == "not needed" and seen.on_wall:
        yield "said that it need not be held, on a wall"
    excused = gone or (hold_unconfirmable(cell) and not seen.at_links)
    if seen.cycles and seen.state not in ("HELD", "not needed") and not excused:
        yield f"not held: {seen.held.why if seen.held is not None else 'no report'}"
    if gone:
        return
    if not seen.moved_m <= measured.most_m:
        yield f"moved by {moved_mm:.1f} mm after the stop, more than {1e3 * measured.most_m:.1f} mm"
    most_m = crept_most_m(cell, seen.looked_s)
    if seen.state != "HELD" and not seen.crept_m <= most_m:
        yield f"moved by {crept_mm:.1f} mm after the report, more than {1e3 * most_m:.1f} mm"


def _wrong_of_path(cell: Cell, seen: Seen) -> Iterator[str]:
    """Yield every violated promise about where the robot truly went, and what was measured of that."""
    if not seen.cycles or _gone(cell, seen):
        return
    if not seen.astray_m <= MOST_ASTRAY_M:
        yield f"driven {1e3 * seen.astray_m:.0f} mm off its reference"
    found = seen.figures
    if found is None:
        return
    said_mm, true_mm = 1e3 * found.said_m, 1e3 * found.true_m
    if not found.true_m <= PASS_M and found.said_m <= PASS_M:
        yield f"passes with {said_mm:.1f} mm to its goal, and ended {true_mm:.1f} mm from it"
    elif not (found.marked or _is_told_unmeasured(seen) or abs(found.said_m - found.true_m) <= FIGURE_M):
        yield f"measures {said_mm:.1f} mm to its goal without a mark, and ended {true_mm:.1f} mm from it"


def _is_told_unmeasured(seen: Seen) -> bool:
    """Whether the bench has no figure of the end, and an event that says why."""
    found = seen.figures
    return found is not None and np.isnan(found.said_m) and any(_kinds(one.suspects) for one in seen.events)


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
