"""Injected faults whose start time was never reached: the test has not met them.

A closing bench stops the robot and looks at it. A fault that begins during that look may still cost the
robot, but nothing that a test or a run did has been under it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from hil.core.clock import NS_PER_S
from hil.fakes.fault import Fault, describe, parse_fault


def not_begun(faults: Iterable[Fault], world_ns: int) -> tuple[str, ...]:
    """Specs of those faults that begin later than a world has come.

    Args:
        faults: as they were planned.
        world_ns: how far the world has come.
    """
    return tuple(describe(fault) for fault in faults if fault.start_ns > world_ns)


def not_begun_in_words(specs: Sequence[str], world_ns: int, looked_ns: int) -> str:
    """One line for the user, who asked for the faults.

    Args:
        specs: of faults that begin later than `world_ns`.
        world_ns: how far the world had come when the bench was closed.
        looked_ns: the same when the look at the stopped robot was over.
    """
    begin_s = {spec: parse_fault(spec).start_ns / NS_PER_S for spec in specs}
    never = [spec for spec, at_s in begin_s.items() if at_s > looked_ns / NS_PER_S]
    closed = f"the bench was closed at {world_ns / NS_PER_S:.2f} s of world time"
    reported = [
        f"fault {spec} began only after the stop, at {at_s:.2f} s of world time, while the bench checked "
        f"that the robot is held: {closed}, so that nothing that was done has met it"
        for spec, at_s in begin_s.items()
        if spec not in never
    ]
    if never:
        what, began = ("fault", "it began") if len(never) == 1 else ("faults", "they began")
        reported.append(f"{what} {', '.join(never)} never acted: {closed}, before {began}")
    return "; ".join(reported)
