"""Samples and records as bytes that differ wherever a single bit of them does; a `repr` rounds arrays."""

import dataclasses
import struct
from collections.abc import Mapping

import numpy as np


def bits(value):
    """Bytes of numbers, arrays, dataclasses, and whatever holds them."""
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if isinstance(value, float):
        return struct.pack("<d", value)
    if dataclasses.is_dataclass(value):
        return b"".join([bits(getattr(value, field.name)) for field in dataclasses.fields(value)])
    if isinstance(value, Mapping):
        return b"".join([bits(pair) for pair in value.items()])
    if isinstance(value, (tuple, list)):
        return b"(" + b"".join([bits(one) for one in value]) + b")"
    return repr(value).encode()
