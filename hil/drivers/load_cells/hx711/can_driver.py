"""Load cells whose counts come in CAN frames, by a DBC file."""

from collections.abc import Mapping

from hil.config.load_cells import CanCellsConfig
from hil.core.errors import DataError
from hil.core.signals import LoadCellSample, Stamp
from hil.drivers.load_cells.hx711.counts_to_force import Judge
from hil.links.can_bus import shown_key
from hil.links.dbc_file import RawSignal, key_of_message, load_database, raw_signal
from hil.streams.can_sensor import CanSensor

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
        return {"model": "HX711", "dbc": str(self.config.dbc_path), "frame": shown_key(frame_id)}

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


def _layout(config: CanCellsConfig) -> tuple[int, int, tuple[RawSignal, ...]]:
    """Identifier, length and fields; raises `DataError`."""
    path, expected = config.dbc_path, "signed 24-bit counts with factor 1 and offset 0, in every frame"
    for message in load_database(path).messages:
        if not {signal.name for signal in message.signals} >= set(config.signals):
            continue
        fields = [raw_signal(message, n, path, expected, bits=_BITS, signed=True) for n in config.signals]
        multiplexed = [n for n, field in zip(config.signals, fields, strict=True) if field.sent_when]
        if multiplexed:
            what = f"{' and '.join(multiplexed)} in message {message.name} is multiplexed"
            raise DataError(str(path), what, expected=expected)
        return key_of_message(message, config.node_id, path), message.length, tuple(fields)
    raise DataError(
        str(path),
        "no message has both " + " and ".join(config.signals),
        expected="both names of load_cells.signals in one message of the DBC",
        remedy="correct load_cells.signals or load_cells.dbc",
    )
