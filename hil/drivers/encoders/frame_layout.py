"""Bit positions of the encoder frames, taken from a DBC file once and then applied without it.

cantools reads and checks the DBC (`hil.links.dbc_file`); decoding a frame is then two shifts per
signal, a tenth of the cost of a general decode (a test compares the two).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from hil.config.encoders import EncodersConfig
from hil.core.errors import DataError
from hil.links.dbc_file import load_database

SEQUENCE, NODE_TIME = "Sequence", "NodeTime"
_WORD_BITS = 18


@dataclass(frozen=True)
class Field:
    """Where one unsigned signal lies in a frame."""

    order: Literal["little", "big"]
    shift: int
    mask: int

    def take(self, data: bytes | bytearray) -> int:
        """The raw value in a frame's data."""
        return int.from_bytes(data, self.order) >> self.shift & self.mask


@dataclass(frozen=True)
class FrameLayout:
    """One frame: `words` are (wheel index, field) pairs; `time_lsb_s` is the unit of the node time."""

    frame_id: int
    name: str
    length: int
    words: tuple[tuple[int, Field], ...]
    sequence: Field
    time: Field
    time_lsb_s: float

    @cached_property
    def _fast(self) -> tuple[Callable[[bytes | bytearray], tuple[int]], tuple[int, ...]] | None:
        """Fast decoder of a frame of two words in eight bytes of one byte order; None for any other frame.

        (unpacks the bytes to one number; wheel, shift, mask of each word, shift, mask of counter and time).
        """
        sequence, time = self.sequence, self.time
        orders = {sequence.order, time.order, *(field.order for _, field in self.words)}
        if len(orders) > 1 or len(self.words) != 2 or self.length != 8:
            return None
        (left, one), (right, other) = self.words
        words = (left, one.shift, one.mask, right, other.shift, other.mask)
        number = struct.Struct("<Q" if sequence.order == "little" else ">Q").unpack
        return number, (*words, sequence.shift, sequence.mask, time.shift, time.mask)

    def decode(self, data: bytes | bytearray) -> tuple[int, int, Sequence[tuple[int, int]]]:
        """Raw sequence number, node time and (wheel index, word) of a frame's data."""
        fast = self._fast
        if fast is None:
            words = [(wheel, field.take(data)) for wheel, field in self.words]
            return self.sequence.take(data), self.time.take(data), words
        number, (left, shift, mask, right, shift_2, mask_2, at, sequence_mask, time_at, time_mask) = fast
        (value,) = number(data)
        pair = (left, value >> shift & mask), (right, value >> shift_2 & mask_2)
        return value >> at & sequence_mask, value >> time_at & time_mask, pair


def load_layout(config: EncodersConfig) -> dict[int, FrameLayout]:
    """Layouts by frame identifier.

    Raises:
        DataError: the DBC cannot be read or does not describe the four configured signals.
    """
    path = config.dbc_path
    database = load_database(path)
    found: dict[int, FrameLayout] = {}
    missing = set(config.signals)
    for message in database.messages:
        words = tuple(
            (wheel, _field(message, name, path))
            for wheel, name in enumerate(config.signals)
            if any(s.name == name for s in message.signals)
        )
        if not words:
            continue
        missing -= {config.signals[wheel] for wheel, _ in words}
        if any(field.mask.bit_length() != _WORD_BITS for _, field in words):
            raise DataError(
                str(path),
                f"message {message.name} has angle signals of another width",
                expected="18-bit raw words",
            )
        time = _field(message, NODE_TIME, path)
        scale = next(s.scale for s in message.signals if s.name == NODE_TIME)
        frame_id = message.frame_id + config.node_id
        found[frame_id] = FrameLayout(
            frame_id, message.name, message.length, words, _field(message, SEQUENCE, path), time, float(scale)
        )
    if missing:
        raise DataError(
            str(path),
            "no signal " + ", ".join(sorted(missing)),
            expected="every name of encoders.signals in the DBC",
            remedy="correct encoders.signals or encoders.dbc",
        )
    return found


def _field(message: Any, name: str, path: Path) -> Field:
    for signal in message.signals:
        if signal.name == name:
            mask = (1 << signal.length) - 1
            if signal.byte_order == "little_endian":
                return Field("little", signal.start, mask)
            from_top = signal.start // 8 * 8 + 7 - signal.start % 8
            return Field("big", 8 * message.length - from_top - signal.length, mask)
    raise DataError(
        str(path), f"message {message.name} has no signal {name}", expected=f"{SEQUENCE} and {NODE_TIME}"
    )
