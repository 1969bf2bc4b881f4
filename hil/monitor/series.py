"""Time series of the loop as columns: what the plots show; pure numpy, no Rerun."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from hil.clock import NS_PER_S
from hil.geometry import Array, wrap
from hil.signals import SERVOS, CycleRecord

_SENSORS = ("servos", "encoders", "imu", "tracker", "mocap")
_POSE_SUFFIXES = ("_x_m", "_y_m", "_theta_rad")


@dataclass
class Series:
    """Rows of one plot that wait to be sent; `names` label the columns."""

    names: tuple[str, ...]
    t_s: list[float] = field(default_factory=list)
    cycles: list[int] = field(default_factory=list)
    rows: list[Array] = field(default_factory=list)


class SeriesCollector:
    """Collects the rows of every plot between two sends."""

    def __init__(self) -> None:
        self._start_ns: int | None = None
        self._series: dict[str, Series] = {}
        self._seen_ns: dict[str, int] = {}

    def seconds(self, record: CycleRecord) -> float:
        """Time of a cycle since the first one, s."""
        if self._start_ns is None:
            self._start_ns = record.inputs.t_ns
        return (record.inputs.t_ns - self._start_ns) / NS_PER_S

    def add(self, record: CycleRecord) -> None:
        """Take one cycle's figures."""
        t_s = self.seconds(record)
        for entity, names, values in self._figures(record):
            series = self._series.get(entity)
            if series is None or series.names != names:
                series = self._series[entity] = Series(names)
            series.t_s.append(t_s)
            series.cycles.append(record.cycle)
            series.rows.append(np.asarray(values, dtype=np.float64))

    def take(self) -> list[tuple[str, Series]]:
        """Everything since the last call, by entity."""
        taken = [(entity, series) for entity, series in self._series.items() if series.rows]
        for entity, series in taken:
            self._series[entity] = Series(series.names)
        return taken

    def _figures(self, record: CycleRecord) -> Iterator[tuple[str, tuple[str, ...], Array | list[float]]]:
        inputs = record.inputs
        if inputs.servos:
            sample = inputs.servos[-1]
            yield "servos/position_rad", SERVOS, sample.position_rad
            yield "servos/velocity_rad_s", SERVOS, sample.velocity_rad_s
            yield "servos/current_a", SERVOS, sample.current_a
        if inputs.health:
            yield "servos/temperature_c", SERVOS, inputs.health[-1].temperature_c
            yield "servos/voltage_v", SERVOS, inputs.health[-1].voltage_v
        yield "state/twist", ("v_x_m_s", "v_y_m_s", "omega_rad_s"), record.state.twist_body
        yield "state/heading_rad", ("estimate",), [float(record.state.pose_body_in_wall[2])]
        if record.reference is not None:
            error = record.reference.pose_in_wall - record.state.pose_body_in_wall
            yield "state/tracking_error_m", ("x", "y"), [float(error[0]), float(error[1])]
            yield "state/tracking_error_rad", ("theta",), [wrap(float(error[2]))]
        yield from self._ages(record)
        yield from _diagnostics(record)
        for name, value_ns in record.timing_ns.items():
            yield f"loop/{name}_ms", (name,), [value_ns / 1e6]

    def _ages(self, record: CycleRecord) -> Iterator[tuple[str, tuple[str, ...], list[float]]]:
        for name in _SENSORS:
            samples = getattr(record.inputs, name)
            if samples:
                self._seen_ns[name] = samples[-1].stamp.t_ns
            if name in self._seen_ns:
                age_ns = record.inputs.t_ns - self._seen_ns[name]
                yield f"ages/{name}_ms", (name,), [age_ns / 1e6]


def _diagnostics(record: CycleRecord) -> Iterator[tuple[str, tuple[str, ...], list[float]]]:
    for name, value in record.state.diagnostics.items():
        if name.endswith(_POSE_SUFFIXES):
            continue
        group = "innovations" if name.startswith(("nis", "gate", "innovation")) else "estimator"
        yield f"{group}/{name}", (name,), [float(value)]


def observer_poses(record: CycleRecord) -> dict[str, tuple[float, float]]:
    """Positions of the estimators that run beside the loop, from the state's diagnostics, m."""
    found = record.state.diagnostics
    names = (key[: -len("_x_m")] for key in found if key.endswith("_x_m"))
    return {n: (found[f"{n}_x_m"], found[f"{n}_y_m"]) for n in names if f"{n}_y_m" in found}


def finite(values: Array) -> bool:
    """Whether every value is a number."""
    return all(math.isfinite(v) for v in np.ravel(values))
