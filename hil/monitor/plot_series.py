"""Time series of the loop as columns: what the plots show; pure numpy, no Rerun."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hil.core.clock import NS_PER_S
from hil.core.device import Figures
from hil.core.geometry import Array, wrap
from hil.core.kind_figures import KindFigures
from hil.core.registry import kinds, sample_names
from hil.core.signals import CycleRecord, Status

_GROUPS = {
    "nis_mean": "estimator/mean_nis",
    "nis": "innovations/normalised",
    "gate": "innovations/normalised",
    "innovation": "innovations/raw",
    "rejected": "estimator/rejected",
    "reanchored": "estimator/rejected",
    "age": "estimator/age_s",
    "adhesion": "adhesion/force_n",
    "utilisation": "adhesion/utilisation",
}
_OTHER = "estimator/states"
_SLOW = ("estimator/mean_nis", "estimator/rejected", "estimator/age_s", _OTHER)
_SLOW_S = 0.1


@dataclass(frozen=True)
class Series:
    """Rows of one plot that are to be sent.

    Attributes:
        names: labels of the columns.
        t_s: (n,) seconds since the first cycle.
        cycles: (n,) cycle numbers.
        values: (n, len(names)); NaN where a cycle had no such figure.
        before: number of columns that the same plot already has.
    """

    names: tuple[str, ...]
    t_s: Array
    cycles: list[int]
    values: Array
    before: int


class SeriesCollector:
    """Collects the rows of every plot between two sends; few plots of many columns, because plots cost time.

    The number of columns of a Rerun entity is fixed: figures that come later get an entity below it.
    """

    def __init__(self) -> None:
        self._start_ns: int | None = None
        self._names: dict[str, list[str]] = {}
        self._bounds: dict[str, list[int]] = {}
        self._rows: dict[str, list[tuple[float, int, Figures]]] = {}
        self._seen_ns: dict[str, int] = {}
        self._slow_s = -math.inf
        self._of_kind = KindFigures()

    def seconds(self, record: CycleRecord) -> float:
        """Time of a cycle since the first one, s."""
        if self._start_ns is None:
            self._start_ns = record.inputs.t_ns
        return (record.inputs.t_ns - self._start_ns) / NS_PER_S

    def add(self, record: CycleRecord) -> None:
        """Take one cycle's figures; counters and slow states ten times a second only."""
        t_s = self.seconds(record)
        slow = not 0.0 <= t_s - self._slow_s < _SLOW_S - 1e-6
        if slow:
            self._slow_s = t_s
        for entity, figures in self._figures(record):
            if entity in _SLOW and not slow:
                continue
            names = self._names.setdefault(entity, [])
            if len(figures) != len(names) or any(n not in names for n in figures):
                names += [n for n in figures if n not in names]
            self._rows.setdefault(entity, []).append((t_s, record.cycle, figures))

    def take(self) -> list[tuple[str, Series]]:
        """Everything since the last call, by entity."""
        taken = []
        for entity, rows in self._rows.items():
            names, bounds = self._names[entity], self._bounds.setdefault(entity, [0])
            if bounds[-1] < len(names):
                bounds.append(len(names))
            t_s, cycles = np.array([t_s for t_s, _, _ in rows]), [cycle for _, cycle, _ in rows]
            for k, (low, high) in enumerate(pairwise(bounds)):
                own = tuple(names[low:high])
                values = np.array([[figures.get(n, math.nan) for n in own] for _, _, figures in rows])
                series = Series(own, t_s, cycles, values, low)
                taken.append((f"{entity}/later_{k}" if k else entity, series))
        self._rows = {}
        return taken

    def _figures(self, record: CycleRecord) -> Iterator[tuple[str, Figures]]:
        inputs, state = record.inputs, record.state
        for kind in map(kinds().__getitem__, sample_names(inputs)):
            yield from self._of_kind(kind, inputs)
        yield "state/twist", _named(("v_x_m_s", "v_y_m_s", "omega_rad_s"), state.twist_body)
        heading = {"estimate": float(state.pose_body_in_wall[2])}
        if record.reference is not None:
            error = record.reference.pose_in_wall - state.pose_body_in_wall
            yield "state/tracking_error_m", _named(("x", "y"), error)
            heading["error"] = wrap(float(error[2]))
        yield "state/heading_rad", heading
        yield "ages", self._ages(record)
        yield from _diagnostics(record)
        if record.timing_ns:
            yield "loop", {name: value_ns / 1e6 for name, value_ns in record.timing_ns.items()}

    def _ages(self, record: CycleRecord) -> Figures:
        """Age of every device's newest sample, ms."""
        for name in sample_names(record.inputs):
            samples = record.inputs.of(name)
            if samples:
                self._seen_ns[name] = samples[-1].stamp.t_ns
        return {name: (record.inputs.t_ns - t_ns) / 1e6 for name, t_ns in self._seen_ns.items()}


def _named(names: Sequence[str], values: Array) -> Figures:
    return dict(zip(names, values.tolist(), strict=False))


def _diagnostics(record: CycleRecord) -> Iterator[tuple[str, Figures]]:
    groups: dict[str, dict[str, float]] = {}
    for name, value in record.state.diagnostics.items():
        group = next((g for prefix, g in _GROUPS.items() if name.startswith(prefix + "_")), _OTHER)
        groups.setdefault(group, {})[name] = float(value)
    yield from groups.items()


def conditions(record: CycleRecord) -> dict[str, str]:
    """What is wrong with each device's newest sample, in words; empty text when nothing is."""
    found = {}
    for name in sample_names(record.inputs):
        samples = record.inputs.of(name)
        if not samples:
            continue
        status = samples[-1].status
        channels = status if isinstance(status, tuple) else (status,)
        wrong = [(k, s.value) for k, s in enumerate(channels) if s is not Status.OK]
        reasons = {reason for _, reason in wrong}
        if len(wrong) == len(channels) and len(reasons) == 1:
            found[name] = reasons.pop()
            continue
        found[name] = ", ".join(f"{kinds()[name].labels[k]} {reason}" for k, reason in wrong)
    return found


def finite(values: Array) -> bool:
    """Whether every value, of any shape, is a number."""
    return all(math.isfinite(v) for v in np.ravel(values))
