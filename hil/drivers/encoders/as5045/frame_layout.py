"""Bit positions of the encoder frames, taken from a DBC file once and then applied without it.

cantools reads and checks the DBC (`hil.links.dbc_file`); decoding a frame is then two shifts per
signal, a tenth of the cost of a general decode (a test compares the two).
"""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from hil.config.encoders import EncodersConfig
from hil.core.errors import DataError
from hil.links.dbc_file import RawSignal, key_of_message, load_database, raw_signal

SEQUENCE, NODE_TIME = "Sequence", "NodeTime"
_WORD_BITS = 18


@dataclass(frozen=True)
class FrameLayout:
    """One frame.

    Attributes:
        key: identifier and its width (`hil.links.can_bus.frame_key`).
        name: name of the message.
        length: number of data bytes.
        words: (wheel index, signal) pairs; a multiplexed frame has some of them.
        sequence: number of the sample set, counting up.
        time: time of the node.
        time_lsb_s: unit of the node's time, s.
    """

    key: int
    name: str
    length: int
    words: tuple[tuple[int, RawSignal], ...]
    sequence: RawSignal
    time: RawSignal
    time_lsb_s: float

    @cached_property
    def _fast(self) -> tuple[Callable[[bytes | bytearray], tuple[int]], tuple[int, ...]] | None:
        """Fast decoder of a frame of two words in eight bytes of one byte order; None for any other frame.

        (unpacks the bytes to one number; wheel, shift, mask of each word, shift, mask of counter and time).
        """
        sequence, time = self.sequence, self.time
        orders = {sequence.order, time.order, *(field.order for _, field in self.words)}
        multiplexed = any(field.sent_when for _, field in self.words)
        if len(orders) > 1 or len(self.words) != 2 or self.length != 8 or multiplexed:
            return None
        (left, one), (right, other) = self.words
        words = (left, one.shift, one.mask, right, other.shift, other.mask)
        number = struct.Struct("<Q" if sequence.order == "little" else ">Q").unpack
        return number, (*words, sequence.shift, sequence.mask, time.shift, time.mask)

    def decode(self, data: bytes | bytearray) -> tuple[int, int, Sequence[tuple[int, int]]]:
        """Raw sequence number, node time and (wheel index, word) of a frame; no word if it has none."""
        fast = self._fast
        if fast is None:
            words = [(wheel, field.take(data)) for wheel, field in self.words if field.is_sent(data)]
            return self.sequence.take(data), self.time.take(data), words
        number, (left, shift, mask, right, shift_2, mask_2, at, sequence_mask, time_at, time_mask) = fast
        (value,) = number(data)
        pair = (left, value >> shift & mask), (right, value >> shift_2 & mask_2)
        return value >> at & sequence_mask, value >> time_at & time_mask, pair


def load_layout(config: EncodersConfig) -> dict[int, FrameLayout]:
    """Layouts by the key of the frame.

    Raises:
        DataError: the DBC cannot be read or does not describe the four configured signals as raw words.
    """
    path, layouts = config.dbc_path, dict[int, FrameLayout]()
    described = list[str]()
    for message in load_database(path).messages:
        names = [name for name in config.signals if any(s.name == name for s in message.signals)]
        if names:
            layout = _layout_of(message, names, config, path)
            layouts[layout.key] = layout
            described += names
    odd = {name: described.count(name) for name in config.signals if described.count(name) != 1}
    if odd:
        raise DataError(
            str(path),
            ", ".join(
                f"{n} messages have a signal {name}" if n else f"no signal {name}" for name, n in odd.items()
            ),
            expected="every name of encoders.signals in one message of the DBC",
            remedy="correct encoders.signals or encoders.dbc",
        )
    return layouts


def _layout_of(message: Any, names: Sequence[str], config: EncodersConfig, path: Path) -> FrameLayout:
    raw = "raw unsigned 18-bit words with factor 1 and offset 0"
    words = tuple(
        (config.signals.index(name), raw_signal(message, name, path, raw, bits=_WORD_BITS, signed=False))
        for name in names
    )
    counted = f"{SEQUENCE} and {NODE_TIME} as integers in every frame with angles"
    sequence, time = (raw_signal(message, name, path, counted) for name in (SEQUENCE, NODE_TIME))
    if sequence.sent_when or time.sent_when:
        what = f"{SEQUENCE} or {NODE_TIME} in message {message.name} is multiplexed"
        raise DataError(str(path), what, expected=counted)
    scale = float(message.get_signal_by_name(NODE_TIME).scale)
    key = key_of_message(message, config.node_id, path)
    return FrameLayout(key, message.name, message.length, words, sequence, time, scale)
