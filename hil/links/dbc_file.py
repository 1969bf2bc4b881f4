"""A DBC file, read by cantools: frames on a CAN bus, and where raw integers lie in them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import cantools
from cantools.database import Error as CantoolsError
from cantools.database import UnsupportedDatabaseFormatError

from hil.core.errors import DataError, reason_of
from hil.links.can_bus import STANDARD_IDS, frame_key
from hil.support.file_reading import read_bytes

_MOST_BYTES = 4 << 20
_ENCODING = "cp1252"  # of every DBC file; cantools reads them so too


def load_database(path: Path) -> Any:
    """The `cantools.database.can.Database` of a file; the same text gives the same object.

    Raises:
        DataError: it cannot be read.
    """
    try:
        return _parsed(read_bytes(path, _MOST_BYTES).decode(_ENCODING, errors="replace"))
    except OSError as error:
        raise DataError(str(path), f"the DBC cannot be read ({reason_of(error)})") from None
    except (CantoolsError, UnsupportedDatabaseFormatError, ValueError) as error:
        raise DataError(str(path), f"not a usable DBC ({str(error).splitlines()[0]})") from None


@lru_cache(maxsize=8)
def _parsed(text: str) -> Any:
    """Parse each text once: a bench is opened many times in one process, each time with three readers."""
    return cantools.database.load_string(text, "dbc")


@dataclass(frozen=True)
class RawSignal:
    """Raw integer in a frame.

    Attributes:
        order: byte order of the frame's data when it is read as one number.
        shift: number of bits below the signal in that number.
        mask: mask of the signal's bits, after the shift.
        sign_bit: value of the sign bit; 0 for an unsigned signal.
        sent_when: multiplexers, each with the values under which the frame has this signal; empty for all.
    """

    order: Literal["little", "big"]
    shift: int
    mask: int
    sign_bit: int = 0
    sent_when: tuple[tuple[RawSignal, frozenset[int]], ...] = ()

    def take(self, data: bytes | bytearray) -> int:
        """Raw value in a frame's data."""
        value = int.from_bytes(data, self.order) >> self.shift & self.mask
        return (value ^ self.sign_bit) - self.sign_bit

    def is_sent(self, data: bytes | bytearray) -> bool:
        """Whether this frame has the signal, by its multiplexers."""
        return all(multiplexer.take(data) in values for multiplexer, values in self.sent_when)


def raw_signal(
    message: Any, name: str, path: Path, expected: str, *, bits: int = 0, signed: bool | None = None
) -> RawSignal:
    """Position of a signal whose raw integer is used.

    Args:
        message: message of cantools.
        name: name of a signal of this message.
        path: DBC file, for errors.
        expected: words for what the driver reads, for errors.
        bits: width that the signal must have; 0 for any.
        signed: sign that the signal must have, and then no factor and no offset; None for any.

    Raises:
        DataError: the message lacks the signal, or describes another kind of number.
    """
    signals = {signal.name: signal for signal in message.signals}
    signal = signals.get(name)
    if signal is None:
        raise DataError(str(path), f"message {message.name} has no signal {name}", expected=expected)
    scaled = (signal.scale, signal.offset) != (1, 0)
    wrong = [
        "is a floating-point number" * signal.is_float,
        f"has a width of {signal.length} bits" * (signal.length not in (bits, bits or signal.length)),
        f"is {'signed' if signal.is_signed else 'unsigned'}" * (signed not in (None, signal.is_signed)),
        f"has factor {signal.scale:g} and offset {signal.offset:g}" * (signed is not None and scaled),
    ]
    if any(wrong):
        what = f"{name} in message {message.name} " + ", ".join(filter(None, wrong))
        raise DataError(str(path), what, expected=expected)
    return _position(signal, message, tuple(_conditions(signal, signals, message)))


def _conditions(
    signal: Any, signals: dict[str, Any], message: Any
) -> Iterable[tuple[RawSignal, frozenset[int]]]:
    while signal.multiplexer_ids is not None:
        values, signal = frozenset(signal.multiplexer_ids), signals[signal.multiplexer_signal]
        yield _position(signal, message, ()), values


def _position(
    signal: Any, message: Any, sent_when: tuple[tuple[RawSignal, frozenset[int]], ...]
) -> RawSignal:
    mask, sign_bit = (1 << signal.length) - 1, (1 << signal.length - 1) * signal.is_signed
    if signal.byte_order == "little_endian":
        return RawSignal("little", signal.start, mask, sign_bit, sent_when)
    from_top = signal.start // 8 * 8 + 7 - signal.start % 8
    return RawSignal("big", 8 * message.length - from_top - signal.length, mask, sign_bit, sent_when)


def key_of_message(message: Any, node_id: int, path: Path) -> int:
    """Key of a message's frames (`hil.links.can_bus.frame_key`), moved by a node's address.

    Raises:
        DataError: the address moves the identifier beyond 11 bits, or 29.
    """
    moved, extended = message.frame_id + node_id, bool(message.is_extended_frame)
    if moved >= (1 << 29 if extended else STANDARD_IDS):
        raise DataError(
            str(path),
            f"node_id {node_id} moves message {message.name} to 0x{moved:X}",
            expected=f"an identifier of {29 if extended else 11} bits",
        )
    return frame_key(moved, extended)
