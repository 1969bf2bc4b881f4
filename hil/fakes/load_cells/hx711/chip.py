"""Sends the counts of the emulated load cells: as CAN frames, or as lines of text."""

from __future__ import annotations

from hil.config.load_cells import CanCellsConfig, LineCellsConfig
from hil.core.clock import NS_PER_S
from hil.fakes.can_channel import CanChannel
from hil.fakes.emulation_request import EmulationRequest
from hil.fakes.load_cells.hx711.cells import CELL_FAULTS, DELAY_S, Cells, LoadCellTruthOptions
from hil.fakes.serial_chip import Reply, SerialChip
from hil.fakes.world import Scheduled, World
from hil.faults.fault import IN, Supported

FRAME_ID = 0x1B0
_MASK = 0xFFFFFF
_CLOCK_ERROR = 200e-6


def _period_ns(rate_hz: float) -> int:
    """Conversion period; an HX711 runs on its own oscillator."""
    return round(NS_PER_S / rate_hz * (1.0 + _CLOCK_ERROR))


class CellNode(Scheduled):
    """Sends one frame for each conversion.

    Args:
        world: truth, seed and faults; the node registers itself there.
        channel: the CAN bus.
        config: rate and address.
        cells: the load cells.
    """

    Options = LoadCellTruthOptions
    announces = True

    @classmethod
    def build(cls, request: EmulationRequest, channel: CanChannel) -> CellNode:
        """Make the node from its table of the bench file."""
        return cls(request.world, channel, request.config, _cells(request))

    def __init__(self, world: World, channel: CanChannel, config: CanCellsConfig, cells: Cells) -> None:
        self._channel, self._cells = channel, cells
        self._frame_id = FRAME_ID + config.node_id
        self._period_ns = _period_ns(config.rate_hz)
        self._sequence = 0
        channel.declare(cells.name, CELL_FAULTS, ways=IN)
        self._due_ns = int(world.rng(f"{cells.name}.phase").integers(1, self._period_ns))
        world.add(self)

    def begin_in_use(self) -> None:
        """Mark the node as independent: only this process receives its frames."""
        self.alone = True

    def next_due_ns(self) -> int:
        """Time of the next conversion."""
        return self._due_ns

    def on_due(self, t_ns: int) -> None:
        """Convert the forces and send them."""
        slow = self._cells.faults.find("slow", t_ns)
        self._due_ns = t_ns + round(self._period_ns * (1.0 if slow is None else slow.period_factor))
        if self._cells.silent(t_ns):
            self._sequence = 0
            return
        first, second = self._cells.counts(t_ns)
        word = first & _MASK | (second & _MASK) << 24 | (self._sequence & 0xFF) << 48 | 3 << 56
        self._sequence += 1
        delayed = self._cells.faults.find("delayed", t_ns)
        send_ns = t_ns + (0 if delayed is None else delayed.delay_ns(DELAY_S))
        self._channel.transmit(self._frame_id, word.to_bytes(8, "little"), send_ns)


class CellLine(SerialChip):
    """Writes a line `LC <number> <counts> <counts>` for each conversion.

    Args:
        world: source of the seed.
        config: rate and baud.
        cells: the load cells.
    """

    Options = LoadCellTruthOptions
    supported_faults: Supported = CELL_FAULTS
    ways = IN

    @classmethod
    def build(cls, request: EmulationRequest) -> CellLine:
        """Make the chip from its table of the bench file."""
        return cls(request.world, request.config, _cells(request))

    def __init__(self, world: World, config: LineCellsConfig, cells: Cells) -> None:
        self.name, self.uart_baud, self._cells = cells.name, config.baud, cells
        self._period_ns = _period_ns(config.rate_hz)
        self._sequence = 0
        self._due_ns = int(world.rng(f"{cells.name}.phase").integers(1, self._period_ns))

    def receive(self, data: bytes, t_ns: int, baud: int) -> list[Reply]:
        """Ignore input, which is for the propellers."""
        return []

    def reset(self, t_ns: int) -> None:
        """Reset everything, as a power cycle does."""
        self._sequence = 0

    def poll(self, t_ns: int) -> list[Reply]:
        """Send one line of counts."""
        slow = self._cells.faults.find("slow", t_ns)
        self._due_ns = t_ns + round(self._period_ns * (1.0 if slow is None else slow.period_factor))
        if self._cells.silent(t_ns):
            self._sequence = 0
            return []
        first, second = self._cells.counts(t_ns)
        delayed = self._cells.faults.find("delayed", t_ns)
        ready_ns = t_ns + (0 if delayed is None else delayed.delay_ns(DELAY_S))
        line = f"LC {self._sequence} {first} {second}\n"
        self._sequence = (self._sequence + 1) % 65536
        return [Reply(ready_ns, line.encode())]

    def next_poll_ns(self) -> int:
        """Time of the next conversion."""
        return self._due_ns


def _cells(request: EmulationRequest) -> Cells:
    return Cells(request.world, request.config, request.options(LoadCellTruthOptions), request.kind)
