"""The interface of a chip with a byte stream, as the serial line uses it.

A chip is a model (registers, firmware, timing); the serial line (`serial_line.py`) adds pacing, USB
latency and wire faults; a transport (in-process pyserial URL or PTY) carries the bytes to a client.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple, Protocol

from hil.fakes.fault import Supported
from hil.fakes.world import NEVER_NS


class Reply(NamedTuple):
    """Bytes a chip puts on the wire: not before `ready_ns` (world time), then paced at the baud rate."""

    ready_ns: int
    data: bytes


class SerialChip(Protocol):
    """A chip (or a bus of chips) at the far end of a serial line.

    Attributes:
        name: device name, also of its faults.
        supported_faults: faults that arise in the chip itself; the line declares them with its own.
        uart_baud: the rate that its UART is set to: the line makes noise of what is sent or heard at another
            one. None where it has none, as a device on USB, or where the chip itself judges the rate.
        polls_alone: `next_poll_ns` becomes earlier only while it receives or is polled.
    """

    name: str
    supported_faults: Supported
    uart_baud: int | None = None
    polls_alone: bool = False

    @abstractmethod
    def receive(self, data: bytes, t_ns: int, baud: int) -> list[Reply]:
        """Take bytes whose last one arrived at `t_ns`, sent at `baud`; return what is answered.

        Bytes may come in any pieces. Where the rates of chip and line differ, by `uart_baud` or a fault,
        `data` is what the chip's UART makes of them.
        `World.sync_plant` has been called for `t_ns`.
        """

    @abstractmethod
    def reset(self, t_ns: int) -> None:
        """Power was cycled (brownout, unplug and replug)."""

    def begin_in_use(self) -> None:
        """Run before the bench opens; nothing by default."""
        return

    def poll(self, t_ns: int) -> list[Reply]:
        """What the chip says unasked at `t_ns`; nothing by default."""
        return []

    def next_poll_ns(self) -> int:
        """When `poll` may have something to say; never by default."""
        return NEVER_NS
