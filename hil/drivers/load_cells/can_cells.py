"""Load cells whose counts come in CAN frames, by a DBC file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hil.config.load_cells import CanCellsConfig
from hil.core.errors import DataError
from hil.core.signals import LoadCellSample, Stamp
from hil.drivers.load_cells.counts_to_force import Judge
from hil.links.can_sensor import CanSensor
from hil.links.dbc_file import load_database

_BITS = 24


class CanCells(CanSensor[CanCellsConfig, LoadCellSample]):
    """Two cells behind one CAN node.

    Attributes:
        malformed: frames of the right identifier and the wrong length since `open`.
    """

    name, what, expected = "load_cells", "conversion", "the cells' node"
    remedy = "check load_cells.dbc and load_cells.node_id"

    def frame_ids(self) -> tuple[int, ...]:
        """Frame identifier of the DBC, with the node's number; raises `DataError` for a wrong DBC."""
        frame_id, self._length, self._fields = _layout(self.config)
        self._judge = Judge(self.config)
        return (frame_id,)

    def identify(self) -> Mapping[str, str]:
        """DBC file and frame in use."""
        (frame_id,) = self._ids
        return {"model": "HX711", "dbc": str(self.config.dbc_path), "frame": f"0x{frame_id:X}"}

    def parse(self, frames: Mapping[int, bytes]) -> tuple[int, int] | None:
        """Counts of both cells."""
        (data,) = frames.values()
        if len(data) != self._length:
            return None
        first, second = self._fields
        return first.take(data), second.take(data)

    def sample(self, item: tuple[int, int], stamp: Stamp) -> LoadCellSample:
        """Forces and what is wrong with them."""
        return self._judge.sample(item, stamp)


class _Field:
    """Where a cell's counts lie in the frame."""

    def __init__(self, order: Any, shift: int) -> None:
        self._order, self._shift = order, shift

    def take(self, data: bytes | bytearray) -> int:
        """Decode the signed counts of a frame."""
        value = int.from_bytes(data, self._order) >> self._shift & (1 << _BITS) - 1
        return value - (1 << _BITS) if value >> (_BITS - 1) else value


def _layout(config: CanCellsConfig) -> tuple[int, int, tuple[_Field, ...]]:
    """Identifier, length and fields; raises `DataError`."""
    path = config.dbc_path
    database = load_database(path)
    for message in database.messages:
        by_name = {signal.name: signal for signal in message.signals}
        if not all(name in by_name for name in config.signals):
            continue
        signals = [by_name[name] for name in config.signals]
        if any(s.length != _BITS or not s.is_signed for s in signals):
            raise DataError(
                str(path),
                f"message {message.name} has counts of another width",
                expected="signed 24-bit counts",
            )
        fields = tuple(_field(s, message.length) for s in signals)
        return message.frame_id + config.node_id, message.length, fields
    raise DataError(
        str(path),
        "no message has both " + " and ".join(config.signals),
        expected="both names of load_cells.signals in one message of the DBC",
        remedy="correct load_cells.signals or load_cells.dbc",
    )


def _field(signal: Any, length: int) -> _Field:
    if signal.byte_order == "little_endian":
        return _Field("little", signal.start)
    from_top = signal.start // 8 * 8 + 7 - signal.start % 8
    return _Field("big", 8 * length - from_top - signal.length)
