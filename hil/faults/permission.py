"""Which faults may be injected in front of which real devices, and where.

A bench asks here before it opens a port. What is injected acts on messages from the device only, so a command
always arrives; the fan's commands come from a process of its own, which has no faults.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from hil.core.clock import NS_PER_S
from hil.core.errors import FaultNotSupportedError
from hil.faults.fault import Fault, Supported
from hil.faults.messages import ARRIVAL_FAULTS, FRAME_FAULTS, STREAM_FAULTS

_LATE: Supported = {"delayed": ("delay_s",)}
_WHOLE: Supported = {kind: options for kind, options in FRAME_FAULTS.items() if kind != "garbage"}
BY_WIRE: Mapping[str, Supported] = {
    "bus": {**STREAM_FAULTS, "unplug": ()},
    "serial": {**STREAM_FAULTS, **_LATE, "unplug": ()},
    "lines": {**_WHOLE, "pieces": STREAM_FAULTS["pieces"], **_LATE, "unplug": ()},
    "can": {**_WHOLE, **_LATE},
    "udp": {**_WHOLE, **_LATE},
    "poses": ARRIVAL_FAULTS,
}
"""Faults that can be injected, and their options, by how the device is connected.

`garbage` of a frame, a datagram or a line of text is random content within a valid form, which a link cannot
make; `delayed` of a bus that is asked are old registers, which a link does not have.
"""
SITUATIONS = ("floor", "tethered", "wall")
"""Where the robot is, from harmless to dangerous."""
ON_A_WALL = frozenset(("drop", "corrupt", "truncate", "duplicate", "silent", "intermittent", "delayed"))
"""Faults of sensors that may be injected while the robot hangs without a tether."""
SERVOS_ON_A_WALL = frozenset(("drop", "corrupt", "silent"))
"""The same of the servo bus: CRC-16 finds every single wrong bit, but may miss random content."""
LONGEST_OF_SERVOS_NS = NS_PER_S
"""Longest fault of the servo bus on a wall."""
HOLDING = ("adhesion", "thrust")
"""Devices that hold the robot, none of which may have faults on a wall."""
SEES_A_SLIDE = ("tracker", "mocap", "load_cells")
"""Sensors, one of which has no fault at any time of a plan on a wall."""
LONGEST_TRAVEL_M = 0.3
"""Longest distance that a robot on a wall drives with a fault in front of one of its devices."""
POWER = ("off", "brownout", "reset")
"""Faults of the power of a device, which only a hand can do."""
_AT_POWER = "use `silent`, which withholds what the device sends; or --by-hand, at a terminal"
_NO_HAND_ON_A_WALL = ("servos", *HOLDING)
"""Devices whose power holds the robot."""


def situation(*, on_wall: bool, tethered: bool) -> str:
    """Where a robot is: `floor`, `tethered` or `wall`."""
    return "floor" if not on_wall else "tethered" if tethered else "wall"


def check(
    faults: Sequence[Fault],
    *,
    bench: str,
    wires: Mapping[str, str],
    seeing: Sequence[str],
    named: Iterable[str],
    most: str,
    present: str,
    by_hand: bool = False,
) -> None:
    """Refuse faults that must not be injected in front of real devices.

    Args:
        faults: faults of real devices, each with the device's name on the bench.
        bench: name of the bench, for messages.
        wires: wire of every real device, by name; empty where it is not known.
        seeing: sensors of the bench that see a slide of this robot.
        named: `[faults] devices` of the bench file.
        most: `[faults] real` of the bench file: the most dangerous situation that it permits.
        present: situation of the robot.
        by_hand: True if an operator switches the power of devices.

    Raises:
        FaultNotSupportedError: names the first fault and the reason.
    """
    for fault in faults:
        if most not in SITUATIONS or SITUATIONS.index(present) > SITUATIONS.index(most):
            raise FaultNotSupportedError(
                f"fault {fault}: {bench} permits faults of real devices "
                + (f"up to {most!r}" if most in SITUATIONS else "nowhere")
                + f", and the robot is {_PLACE[present]}",
                expected=f'[faults] real = "{present}" in the bench file',
                remedy="a robot off the wall needs less; `--emulate` injects at the emulated device",
            )
        if fault.device not in set(named):
            raise FaultNotSupportedError(
                f"fault {fault}: {fault.device} is real, and not in [faults] devices of {bench}",
                expected=", ".join(named) or "no device",
                remedy=f'add "{fault.device}" to devices in [faults], if its messages may be damaged',
            )
        if by_hand and fault.kind in POWER:
            _check_hand(fault, present)
            continue
        holds = present == "wall" and fault.device in HOLDING
        if not holds:
            _check_kind(fault, wires.get(fault.device, ""))
        if present == "wall":
            _check_on_wall(fault)
    if present == "wall":
        _must_leave_one([as_lasting(fault) for fault in faults], seeing)


_PLACE = {"floor": "on the floor", "tethered": "on a wall, on a tether", "wall": "on a wall without a tether"}


def as_lasting(fault: Fault) -> Fault:
    """Return the fault; one that a hand ends without an end, as nobody knows when."""
    return replace(fault, end_ns=None) if fault.kind in POWER else fault


def _check_hand(fault: Fault, present: str) -> None:
    if present == "wall" and fault.device in _NO_HAND_ON_A_WALL:
        raise FaultNotSupportedError(
            f"fault {fault}: the power of {fault.device} holds the robot on its wall",
            expected="a robot on the floor or on a tether",
            remedy="on a wall use `silent` of the servos, for 1 s at most",
        )
    if fault.options:
        raise FaultNotSupportedError(f"fault {fault}: a hand has no options", expected="no option")


def _check_kind(fault: Fault, wire: str) -> None:
    supported = BY_WIRE.get(wire, {})
    if fault.kind in POWER:
        raise FaultNotSupportedError(
            f"fault {fault}: {fault.kind} is of the power of a real device, not of its link",
            expected="one of " + ", ".join(supported),
            remedy=_AT_POWER,
        )
    if fault.kind not in supported:
        raise FaultNotSupportedError(
            f"fault {fault}: it cannot be injected at the link of a real device",
            expected="one of " + ", ".join(supported) if supported else "a device with a known wire",
            remedy="inject it at an emulated device (--emulate)",
        )
    for key in fault.options:
        if key not in supported[fault.kind]:
            raise FaultNotSupportedError(
                f"fault {fault} has an option {key!r} that a link does not have",
                expected="one of " + ", ".join(supported[fault.kind])
                if supported[fault.kind]
                else "no option",
            )
    if fault.kind == "delayed" and fault.start_ns == 0:
        raise FaultNotSupportedError(
            f"fault {fault}: a delay from the start cannot be told from a slow interface",
            expected="a start after the bench was opened, such as @2",
        )


def _check_on_wall(fault: Fault) -> None:
    allowed = SERVOS_ON_A_WALL if fault.device == "servos" else ON_A_WALL
    if fault.device in HOLDING:
        allowed = frozenset()
    if fault.kind not in allowed:
        raise FaultNotSupportedError(
            f"fault {fault}: not permitted while the robot hangs without a tether",
            expected=", ".join(sorted(allowed)) or f"no fault of {fault.device}, which holds the robot",
            remedy="on the floor or on a tether (safety.tethered = true) it is",
        )
    lasts_ns = None if fault.end_ns is None else fault.end_ns - fault.start_ns
    if fault.device == "servos" and (lasts_ns is None or lasts_ns > LONGEST_OF_SERVOS_NS):
        raise FaultNotSupportedError(
            f"fault {fault}: on a wall the servos' answers may be missing for 1 s at most",
            expected=f"a duration of at most {LONGEST_OF_SERVOS_NS / NS_PER_S:g} s (`+1`)",
        )


def _must_leave_one(faults: Sequence[Fault], seeing: Sequence[str]) -> None:
    """Refuse a plan that leaves, at some time, no sensor without a fault that can see a slide."""
    for fault in faults:
        struck = {one.device for one in faults if one.active(fault.start_ns)}
        if all(name in struck for name in seeing):
            raise FaultNotSupportedError(
                f"fault {fault}: from then on no sensor without a fault can see a slide",
                expected=f"one of {', '.join(seeing)} without a fault"
                if seeing
                else "a camera or load cells",
                remedy="let the faults act one after the other, or put the robot on a tether",
            )
