"""Spoils messages: bits, bytes, numbers, pieces; then, now and then, makes lengths and checksums right again.

What comes out is a function of the generator alone, so that a finding repeats.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence

import numpy as np

Seal = Callable[[bytes], bytes]
Step = Callable[[np.random.Generator, bytearray, Sequence[bytes]], None]

_NUMBERS = (
    *(b"\x00", b"\x01", b"\x7f", b"\x80", b"\xff", b"\xff\xff", b"\x00\x80", b"\xff\x7f"),
    *(struct.pack(order + "f", x) for order in "<>" for x in (np.nan, np.inf, -np.inf, 3e38, -0.0)),
    *(struct.pack(order + "d", x) for order in "<>" for x in (np.nan, np.inf, 1e300, -1e-300)),
    *(struct.pack(order + "i", x) for order in "<>" for x in (0, -1, 2**31 - 1, -(2**31))),
    *(struct.pack(order + "q", x) for order in "<>" for x in (-1, 2**63 - 1, -(2**63))),
)
_WORDS = (
    *(b"nan", b"inf", b"1e400", b"-0", b"99999999999999999999", b"\xc3\x28", b"\x00", b"\r", b"\n"),
    *(
        b'"',
        b"'",
        b"[[",
        b"]]",
        b"{",
        b"}",
        b",,",
        b"=",
        b"#",
        b"../..",
        b"null",
        b"true",
        b"1979-05-27",
        b"\\u0000",
    ),
)


def _place(rng: np.random.Generator, data: bytearray) -> int:
    return int(rng.integers(len(data) + 1))


def _flip(rng: np.random.Generator, data: bytearray, _: Sequence[bytes]) -> None:
    if data:
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))


def _byte(rng: np.random.Generator, data: bytearray, _: Sequence[bytes]) -> None:
    if data:
        data[int(rng.integers(len(data)))] = int(rng.integers(256))


def _number(rng: np.random.Generator, data: bytearray, _: Sequence[bytes]) -> None:
    at, number = _place(rng, data), _NUMBERS[int(rng.integers(len(_NUMBERS)))]
    data[at : at + len(number)] = number


def _word(rng: np.random.Generator, data: bytearray, _: Sequence[bytes]) -> None:
    at = _place(rng, data)
    data[at:at] = _WORDS[int(rng.integers(len(_WORDS)))]


def _cut(rng: np.random.Generator, data: bytearray, _: Sequence[bytes]) -> None:
    del data[_place(rng, data) :]


def _hole(rng: np.random.Generator, data: bytearray, _: Sequence[bytes]) -> None:
    at = _place(rng, data)
    del data[at : at + int(rng.integers(1, 9))]


def _twice(rng: np.random.Generator, data: bytearray, _: Sequence[bytes]) -> None:
    at = _place(rng, data)
    data[at:at] = data[at : at + int(rng.integers(1, 40))] * int(rng.integers(1, 4))


def _noise(rng: np.random.Generator, data: bytearray, _: Sequence[bytes]) -> None:
    at = _place(rng, data)
    data[at:at] = rng.bytes(int(rng.integers(1, 20)))


def _graft(rng: np.random.Generator, data: bytearray, seeds: Sequence[bytes]) -> None:
    other = seeds[int(rng.integers(len(seeds)))]
    at, begin = _place(rng, data), int(rng.integers(len(other) + 1))
    data[at:] = other[begin:]


STEPS: tuple[Step, ...] = (_flip, _byte, _number, _word, _cut, _hole, _twice, _noise, _graft)


def spoilt(rng: np.random.Generator, seeds: Sequence[bytes], seal: Seal | None = None) -> bytes:
    """One of the seeds with one to four things wrong; every other time sealed again, where it can be."""
    data = bytearray(seeds[int(rng.integers(len(seeds)))])
    for _ in range(1 + int(rng.integers(4))):
        STEPS[int(rng.integers(len(STEPS)))](rng, data, seeds)
    found = bytes(data[:65_536])
    return seal(found) if seal is not None and rng.random() < 0.5 else found
