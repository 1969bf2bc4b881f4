"""Interface between chips with a byte stream and the serial line.

A chip models registers, firmware and timing. The serial line (`serial_line.py`) adds pacing, USB latency and
wire faults. A transport (in-process pyserial URL or PTY) carries the bytes to a client.
"""

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar, NamedTuple, Protocol

from hil.fakes.world import NEVER_NS
from hil.faults.fault import BOTH, Option, Supported


class Reply(NamedTuple):
    """Bytes sent by a chip: not before `ready_ns` (world time), then paced at the baud rate.

    Attributes:
        goes_on: True if these bytes belong to the same message as the reply before, for faults of the wire.
    """

    ready_ns: int
    data: bytes
    goes_on: bool = False


class SerialChip(Protocol):
    """A chip (or a bus of chips) at the far end of a serial line.

    Attributes:
        name: device name, also that of its faults.
        supported_faults: faults inside the chip; the line declares them together with its own, and leaves
            those to the chip that both have.
        ways: directions in which the line carries bytes, seen from the bench.
        fault_ranges: ranges of its options of faults by `KIND:NAME`, where narrower than usual.
        uart_baud: baud rate of its UART: bytes sent or received at another rate become noise. None for a
            device without UART, as on USB, or if the chip itself checks the rate.
        polls_alone: `next_poll_ns` becomes earlier only in calls of `receive` and `poll`.
    """

    name: str
    supported_faults: Supported
    fault_ranges: ClassVar[Mapping[str, Option]] = {}
    uart_baud: int | None = None
    polls_alone: bool = False
    ways: str = BOTH

    @abstractmethod
    def receive(self, data: bytes, t_ns: int, baud: int) -> list[Reply]:
        """Receive bytes, sent at `baud`, the last of which arrived at `t_ns`; returns the replies.

        Bytes may come in any pieces. If the baud rates of chip and line differ, by `uart_baud` or a fault,
        `data` is what the chip's UART decodes. `World.sync_plant` has been called for `t_ns`.
        """

    @abstractmethod
    def reset(self, t_ns: int) -> None:
        """Power was cycled (brownout, unplug and replug)."""

    def begin_in_use(self) -> None:
        """Put the device into the state of a bench already in use; nothing by default."""
        return

    def poll(self, t_ns: int) -> list[Reply]:
        """Return the data sent without request at `t_ns`; none by default."""
        return []

    def next_poll_ns(self) -> int:
        """Time of the next call of `poll`; never by default."""
        return NEVER_NS
