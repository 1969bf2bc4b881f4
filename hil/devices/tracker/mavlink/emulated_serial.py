"""The emulated computer on a serial line, readable at its own baud rate only."""

from __future__ import annotations

from hil.devices.tracker.mavlink.emulated_computer import Outlet, VisualInertialComputer
from hil.devices.tracker.mavlink.emulated_faults import SUPPORTED_FAULTS
from hil.fakes.fault import Supported
from hil.fakes.serial_chip import Reply, SerialChip
from hil.fakes.world import NEVER_NS

_OF_THE_LINE = ("drop", "corrupt", "truncate", "duplicate", "unplug")
_NOISE = 0x55


class SerialComputer(SerialChip, Outlet):
    """One computer at the far end of a serial line; its cable's faults are the line's.

    It begins to send when it has heard something: before that the line has no rate.

    Args:
        computer: the emulated computer.
        baud: its bits per second.
    """

    def __init__(self, computer: VisualInertialComputer, *, baud: int) -> None:
        self.name = computer.name
        self.supported_faults: Supported = {
            kind: options for kind, options in SUPPORTED_FAULTS.items() if kind not in _OF_THE_LINE
        }
        self._computer, self._baud = computer, baud
        self._in_tune = True
        self._leaving: list[Reply] = []

    def receive(self, data: bytes, t_ns: int, baud: int) -> list[Reply]:
        """Bytes from the other end; at another rate they are noise."""
        self._in_tune = baud == self._baud
        self._computer.attach(self)
        if self._in_tune:
            self._computer.hear(data, t_ns, self)
        return []

    def reset(self, t_ns: int) -> None:
        """The line has no power to switch: the computer has its own."""

    def deliver(self, packet: bytes, t_ns: int) -> None:
        """Put a packet on the line."""
        data = packet if self._in_tune else bytes(byte ^ _NOISE for byte in packet)
        self._leaving.append(Reply(t_ns, data))

    def poll(self, t_ns: int) -> list[Reply]:
        """What has left the computer."""
        leaving, self._leaving = self._leaving, []
        return leaving

    def next_poll_ns(self) -> int:
        """At once, while something waits."""
        return self._leaving[0].ready_ns if self._leaving else NEVER_NS
