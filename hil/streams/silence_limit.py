"""Decides when a silent device is an error; also the error of a driver that is used while closed."""

from collections.abc import Sequence

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import DeviceError
from hil.core.signals import MocapSample, Status, TrackerSample

_PAUSE_NS, _PAUSES = 500_000_000, 3
"""A gap between calls is a pause if longer than this, and than so many times the gap before it."""
USELESS = (Status.NOT_FINITE, Status.IMPLAUSIBLE, Status.STALE, Status.FROZEN)
"""A sender of poses whose poses all have one of these statuses counts as silent."""


def is_pause(gap_ns: int, before_ns: int) -> bool:
    """Whether a device was not read for a while, by the gap between two calls and the gap before it."""
    return gap_ns > _PAUSE_NS and gap_ns > _PAUSES * before_ns


class SilenceTimer:
    """Measures how long a device has sent nothing useful; pauses in which it was not read do not count.

    Args:
        limit_s: longest time without useful data.

    Attributes:
        good_ns: time at which it last sent useful data, moved on by pauses.
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_ns = nanoseconds(limit_s)
        self.begin(0)

    def begin(self, now_ns: int) -> None:
        """Note that the device sent useful data at `now_ns`."""
        self.good_ns = self._asked_ns = now_ns
        self._between_ns = 0

    def overdue_ns(self, useful: bool, now_ns: int) -> int:
        """Time without useful data, ns, once that exceeds the limit; else 0.

        Args:
            useful: True if this read has given useful data.
            now_ns: time of this read.
        """
        gap_ns, before_ns = now_ns - self._asked_ns, self._between_ns
        self._asked_ns, self._between_ns = now_ns, gap_ns
        if useful:
            self.good_ns = now_ns
            return 0
        if is_pause(gap_ns, before_ns):
            self.good_ns += gap_ns
        silent_ns = now_ns - self.good_ns
        return silent_ns if silent_ns > self._limit_ns else 0


def used_while_closed(device: str, port: str) -> DeviceError:
    """The error for a device, named with its port, that is used before it is opened."""
    return DeviceError(device, "used while closed", port=port, remedy="call open() first")


def nothing_usable(noun: str, silent_ns: int, samples: Sequence[MocapSample | TrackerSample]) -> str:
    """Message that no `noun` (pose, frame) was usable for `silent_ns`, with the last sample's status."""
    last = f" (last status {samples[-1].status.value})" if samples else ""
    return f"no usable {noun} for {silent_ns / NS_PER_S:.1f} s{last}"
