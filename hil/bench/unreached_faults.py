"""Injected faults whose start time was never reached: the test did not cover them.

A closing bench stops the robot and looks at it. A fault that begins during this check may still make the
robot fall, but no step of the test or run was exposed to it.
"""

from collections.abc import Iterable, Sequence

from hil.core.clock import NS_PER_S
from hil.faults.fault import Fault


def not_begun(faults: Iterable[Fault], world_ns: int) -> tuple[Fault, ...]:
    """Faults that begin after the present world time.

    Args:
        faults: the planned faults.
        world_ns: present world time.
    """
    return tuple(fault for fault in faults if fault.start_ns > world_ns)


def acting(faults: Iterable[Fault], world_ns: int) -> tuple[Fault, ...]:
    """Faults that act at a world time, or have ended within the second before it."""
    return tuple(
        fault
        for fault in faults
        if fault.start_ns <= world_ns and (fault.end_ns is None or world_ns < fault.end_ns + NS_PER_S)
    )


def not_begun_in_words(faults: Sequence[Fault], world_ns: int, looked_ns: int) -> str:
    """One line for the user about faults that did not begin in time.

    Args:
        faults: faults that begin later than `world_ns`.
        world_ns: world time when the bench was closed.
        looked_ns: world time when the check of the stopped robot was over.
    """
    begin_s = {str(fault): fault.start_ns / NS_PER_S for fault in faults}
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
