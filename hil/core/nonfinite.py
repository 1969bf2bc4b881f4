"""Finds fields of a sample that are not finite although its status is good."""

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from hil.core.device import DeviceKind
from hil.core.signals import Status
from hil.core.third_party_errors import OURS


def unmarked_nonfinite_fields(
    kind: DeviceKind, sample: Any, not_measured: Collection[str] = ()
) -> Iterator[str]:
    """Names of the fields of a sample that hold NaN or infinity although its status is OK.

    An array or a tuple with one row per channel is checked row by row, all other fields only where all
    channels are good. In samples of this project only arrays are checked: a scalar may be NaN because the
    device does not report it.

    Args:
        kind: the device's kind.
        sample: a sample of the device.
        not_measured: fields that its model does not measure.
    """
    states = sample.status if isinstance(sample.status, tuple) else (sample.status,)
    good = [state is Status.OK for state in states]
    for field in fields(sample):
        value = getattr(sample, field.name)
        if field.name in not_measured:
            continue
        if kind.package == OURS and not isinstance(value, np.ndarray):
            continue
        if len(good) > 1 and _rows(value) == len(good):
            whole = all(map(_finite, (row for row, said in zip(value, good, strict=True) if said)))
        else:
            whole = not all(good) or _finite(value)
        if not whole:
            yield field.name


def _rows(value: Any) -> int:
    if isinstance(value, np.ndarray):
        return len(value) if value.ndim else 0
    return len(value) if isinstance(value, tuple) else 0


def _finite(value: Any) -> bool:
    """Whether no number in a value is NaN or infinite, also inside tuples, mappings and dataclasses."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.dtype.kind != "f" or bool(np.isfinite(value).all())
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, tuple):
        return all(map(_finite, value))
    if isinstance(value, Mapping):
        return all(map(_finite, value.values()))
    if is_dataclass(value):
        return all(_finite(getattr(value, field.name)) for field in fields(value))
    return True
