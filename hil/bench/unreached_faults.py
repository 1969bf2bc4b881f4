"""Injected faults that met no control cycle: the test did not cover them.

Some begin after the bench was closed. Others end before the first cycle: they are covered only if they acted
while their device was opened, since the opening is then what they test.

A closing bench stops the robot and looks at it. A fault that begins during this check may still make the
robot fall, but no step of the test or run was exposed to it.
"""

from collections.abc import Iterable, Mapping, Sequence

from hil.core.clock import NS_PER_S
from hil.faults.fault import Fault

_PRESSING = ("adhesion", "load_cells", "thrust")
"""Devices that are watched after their opening until the robot is pressed on its wall."""


def not_begun(faults: Iterable[Fault], world_ns: int) -> tuple[Fault, ...]:
    """Faults that begin after the present world time.

    Args:
        faults: the planned faults.
        world_ns: present world time.
    """
    return tuple(fault for fault in faults if fault.start_ns > world_ns)


def ended_before(
    faults: Iterable[Fault], first_ns: int, opening_ns: Mapping[str, tuple[int, int]], all_open_ns: int
) -> tuple[Fault, ...]:
    """Faults that ended before the first cycle, and did not act while their device was opened.

    Args:
        faults: the planned faults of emulated devices.
        first_ns: world time of the first cycle.
        opening_ns: begin and end of each device's opening, in world time.
        all_open_ns: world time at which the bench was open; until then the force on the wall is watched.
    """
    return tuple(
        fault
        for fault in faults
        if fault.end_ns is not None
        and fault.end_ns <= first_ns
        and not _acted_within(fault, *_looked_at(fault, opening_ns, all_open_ns))
    )


def _looked_at(fault: Fault, opening_ns: Mapping[str, tuple[int, int]], all_open_ns: int) -> tuple[int, int]:
    """Begin and end of the time in which opening the bench needs the device of a fault."""
    begin_ns, end_ns = opening_ns.get(fault.whole, (0, all_open_ns))
    return begin_ns, all_open_ns if fault.whole in _PRESSING else end_ns


def _acted_within(fault: Fault, begin_ns: int, end_ns: int) -> bool:
    return fault.start_ns <= end_ns and (fault.end_ns is None or fault.end_ns > begin_ns)


def acting(faults: Iterable[Fault], world_ns: int) -> tuple[Fault, ...]:
    """Faults that act at a world time, or have ended within the second before it."""
    return tuple(fault for fault in faults if _acted_within(fault, world_ns - NS_PER_S, world_ns))


def not_met_in_words(faults: Sequence[Fault], world_ns: int, looked_ns: int, first_ns: int) -> str:
    """One line for the user about faults that met no cycle.

    Args:
        faults: faults that begin later than `world_ns`, or ended before the first cycle.
        world_ns: world time when the bench was closed.
        looked_ns: world time when the check of the stopped robot was over.
        first_ns: world time of the first cycle.
    """
    late = not_begun(faults, world_ns)
    begin_s = {str(fault): fault.start_ns / NS_PER_S for fault in late}
    never = [spec for spec, at_s in begin_s.items() if at_s > looked_ns / NS_PER_S]
    closed = f"the bench was closed at {world_ns / NS_PER_S:.2f} s of world time"
    reported = [
        f"fault {spec} began only after the stop, at {at_s:.2f} s of world time, while the bench checked "
        f"that the robot is held: {closed}, so that nothing that was done has met it"
        for spec, at_s in begin_s.items()
        if spec not in never
    ]
    reported += [
        f"fault {fault} was over before the first control cycle, at {first_ns / NS_PER_S:.2f} s of world "
        "time, and did not act while its device was opened, so that nothing that was done has met it: let it "
        "begin later, or last until then"
        for fault in faults
        if fault not in late
    ]
    if never:
        what, began = ("fault", "it began") if len(never) == 1 else ("faults", "they began")
        reported.append(f"{what} {', '.join(never)} never acted: {closed}, before {began}")
    return "; ".join(reported)
