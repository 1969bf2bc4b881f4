"""Offsets of clocks: PTP hardware clocks from the wall clock, and the clocks of two recordings.

Two computers that record one run agree as well as their clocks do. Where a network card keeps PTP time
(`ptp4l`), that is better than an undisciplined wall clock.
"""

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from hil.core.clock import NS_PER_S
from hil.core.errors import DataError
from hil.recording.mcap_reader import read_header
from hil.recording.transform_tree import recorded_offset

DEVICES = Path("/dev")
_LOOKS = 25
_CREDIBLE_NS = 60 * NS_PER_S
"""A hardware clock that is not set counts from 1970 or from boot; TAI is 37 s ahead of UTC."""
_CLOCK_OF_FD = 3


class PtpOffset(NamedTuple):
    """A PTP hardware clock's time at the bench clock's zero.

    Attributes:
        device: name of the clock (`ptp0`).
        offset_ns: added to a time of the bench clock it gives that of the hardware clock.
        uncertainty_ns: largest error of `offset_ns`.
        measured_ns: time of the measurement, bench clock.
    """

    device: str
    offset_ns: int
    uncertainty_ns: int
    measured_ns: int


class Shift(NamedTuple):
    """Offset between the bench clocks of two recordings.

    Attributes:
        shift_ns: added to a time of the second recording it gives that of the first.
        uncertainty_ns: uncertainty of the readings; the two clocks themselves may disagree by more.
        by: `wall clock`, or the names of the PTP clocks.
    """

    shift_ns: int
    uncertainty_ns: int
    by: str


def ptp_offsets(
    now_ns: Callable[[], int], folder: Path = DEVICES, read: Callable[[int], int] | None = None
) -> tuple[PtpOffset, ...]:
    """Offsets of all PTP hardware clocks that may be read; empty without any.

    Args:
        now_ns: the bench clock.
        folder: folder in which the kernel has them as `ptp0`, `ptp1`, ...
        read: function from the file descriptor of an open hardware clock to its time.
    """
    found = []
    for path in sorted(folder.glob("ptp[0-9]*")):
        with contextlib.suppress(OSError):
            found.append(_offset(path, now_ns, read or _time_of))
    return tuple(found)


def _offset(path: Path, now_ns: Callable[[], int], read: Callable[[int], int]) -> PtpOffset:
    """Offset by the reading with the shortest time between the bench clock readings before and after it."""
    fd = os.open(path, os.O_RDONLY)
    try:
        looks = [(now_ns(), read(fd), now_ns()) for _ in range(_LOOKS)]
    finally:
        os.close(fd)
    before_ns, there_ns, after_ns = min(looks, key=lambda look: look[2] - look[0])
    middle_ns, width_ns = (before_ns + after_ns) // 2, after_ns - before_ns
    return PtpOffset(path.name, there_ns - middle_ns, width_ns // 2 + 1, middle_ns)


def _time_of(fd: int) -> int:
    """Time of an open hardware clock, ns: the kernel makes a clock of its file descriptor."""
    return time.clock_gettime_ns((~fd << 3) | _CLOCK_OF_FD)


def recorded_ptp(header: Mapping[str, Any]) -> tuple[PtpOffset, ...]:
    """Offsets of hardware clocks in a header; none where there were none."""
    clock = header.get("clock")
    reported = clock.get("ptp", ()) if isinstance(clock, Mapping) else ()
    numbers = PtpOffset._fields[1:]
    return tuple(PtpOffset(str(one["device"]), *(int(one[key]) for key in numbers)) for one in reported)


def shift_between(first: str | Path, second: str | Path) -> Shift:
    """Offset from the second recording's bench clock to that of the first.

    By PTP where both have a disciplined hardware clock, else by the wall clocks.

    Raises:
        DataError: a recording cannot be read, or was made in virtual time.
    """
    headers = {str(path): read_header(path) for path in (first, second)}
    walls = {path: recorded_offset(header) for path, header in headers.items()}
    for path, wall in walls.items():
        if wall is None:
            raise DataError(
                path,
                "says nothing about the time of day",
                expected="a recording of a run in real time",
                remedy="align recordings of virtual time by their cycles",
            )
    a, b = (walls[str(path)] for path in (first, second))
    assert a is not None
    assert b is not None
    kept = [next(_kept(headers[str(path)]), None) for path in (first, second)]
    if kept[0] is not None and kept[1] is not None:
        p, q = kept[0], kept[1]
        return Shift(
            q.offset_ns - p.offset_ns, p.uncertainty_ns + q.uncertainty_ns, f"{p.device}, {q.device}"
        )
    return Shift(b.offset_ns - a.offset_ns, a.uncertainty_ns + b.uncertainty_ns, "wall clock")


def _kept(header: Mapping[str, Any]) -> Iterator[PtpOffset]:
    """Hardware clocks of a header that count as disciplined: their time is near the time of day."""
    wall = recorded_offset(header)
    for ptp in recorded_ptp(header):
        if wall is not None and abs(ptp.offset_ns - wall.offset_ns) < _CREDIBLE_NS:
            yield ptp
