"""When a driver gives up: the error of one that is used while closed, and what silence of poses is."""

from __future__ import annotations

from collections.abc import Sequence

from hil.vocabulary.clock import NS_PER_S
from hil.vocabulary.errors import DeviceError
from hil.vocabulary.signals import MocapSample, Status, TrackerSample

USELESS = (Status.NOT_FINITE, Status.IMPLAUSIBLE, Status.STALE, Status.FROZEN)
"""A sender of poses that sends no others than these is as good as silent."""


def used_while_closed(device: str, port: str) -> DeviceError:
    """The error of a device, named with its port, that was not opened before it was used."""
    return DeviceError(device, "used while closed", port=port, remedy="call open() first")


def nothing_usable(noun: str, silent_ns: int, samples: Sequence[MocapSample | TrackerSample]) -> str:
    """Says that no `noun` (pose, frame) was usable for so long, and what the last of `samples` was."""
    last = f" (last status {samples[-1].status.value})" if samples else ""
    return f"no usable {noun} for {silent_ns / NS_PER_S:.1f} s{last}"
