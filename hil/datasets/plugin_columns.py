"""Samples of the kinds that other packages add, as columns of a table: in each cycle the newest."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from hil.core.clock import NS_PER_S
from hil.core.geometry import Array
from hil.core.signals import CycleRecord


def added_columns(records: Sequence[CycleRecord]) -> tuple[tuple[str, ...], Array]:
    """Names, and values (cycles, names); NaN before a kind's first sample and where a sample has no number.

    A column is called `KIND_FIELD`, an array has one for each element (`bms_cell_v_0`, `bms_map_1_0`), and
    `KIND_t` is when the sample was measured, s since the first cycle. Texts and statuses are no columns: a
    sample that is not good has NaN.
    """
    origin_ns = records[0].inputs.t_ns if records else 0
    rows: list[dict[str, float]] = []
    newest: dict[str, float] = {}
    names: dict[str, None] = {}
    for record in records:
        for kind, samples in record.inputs.added.items():
            if samples:
                found = dict(_numbers(kind, samples[-1]))
                found[f"{kind}_t"] = (samples[-1].stamp.t_ns - origin_ns) / NS_PER_S
                newest = {**newest, **found}
                names.update(dict.fromkeys(found))
        rows.append(newest)
    ordered = tuple(names)
    values = [[row.get(name, math.nan) for name in ordered] for row in rows]
    return ordered, np.array(values, dtype=np.float64).reshape(len(rows), len(ordered))


def _numbers(kind: str, sample: Any) -> Iterator[tuple[str, float]]:
    for field in fields(sample):
        value, name = getattr(sample, field.name), f"{kind}_{field.name}"
        if isinstance(value, (bool, int, float)):
            yield name, float(value)
        elif isinstance(value, np.ndarray) or _is_row(value):
            array = np.asarray(value, dtype=np.float64)
            for place in np.ndindex(array.shape):
                yield "_".join((name, *map(str, place))), float(array[place])


def _is_row(value: Any) -> bool:
    return isinstance(value, tuple) and bool(value) and all(isinstance(v, (bool, int, float)) for v in value)
