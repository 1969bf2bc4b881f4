"""Decides when a silent device is an error; also the error of a driver that is used while closed."""

from __future__ import annotations

from collections.abc import Sequence

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import DeviceError
from hil.core.signals import MocapSample, Status, TrackerSample

_PAUSE_NS, _PAUSES = 500_000_000, 3
"""Nothing asked a device meanwhile: longer than so much, and than so many times what came before."""
USELESS = (Status.NOT_FINITE, Status.IMPLAUSIBLE, Status.STALE, Status.FROZEN)
"""A sender of poses that sends no others than these is as good as silent."""


class Usefulness:
    """For how long a device has been of no use; time in which nothing asked it does not count.

    Args:
        limit_s: for how long it may be.

    Attributes:
        good_ns: when it was of use last, put off by the time in which nothing asked.
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_ns = nanoseconds(limit_s)
        self.begin(0)

    def begin(self, now_ns: int) -> None:
        """Note that the device was of use at `now_ns`."""
        self.good_ns = self._asked_ns = now_ns
        self._between_ns = 0

    def lost_ns(self, useful: bool, now_ns: int) -> int:
        """For how long it has been of no use, once that is longer than it may be; else 0.

        Args:
            useful: whether it was now.
            now_ns: when it was asked.
        """
        gap_ns, before_ns = now_ns - self._asked_ns, self._between_ns
        self._asked_ns, self._between_ns = now_ns, gap_ns
        if useful:
            self.good_ns = now_ns
            return 0
        if gap_ns > _PAUSE_NS and gap_ns > _PAUSES * before_ns:
            self.good_ns += gap_ns
        silent_ns = now_ns - self.good_ns
        return silent_ns if silent_ns > self._limit_ns else 0


def used_while_closed(device: str, port: str) -> DeviceError:
    """The error of a device, named with its port, that was not opened before it was used."""
    return DeviceError(device, "used while closed", port=port, remedy="call open() first")


def nothing_usable(noun: str, silent_ns: int, samples: Sequence[MocapSample | TrackerSample]) -> str:
    """Says that no `noun` (pose, frame) was usable for so long, and what the last of `samples` was."""
    last = f" (last status {samples[-1].status.value})" if samples else ""
    return f"no usable {noun} for {silent_ns / NS_PER_S:.1f} s{last}"
