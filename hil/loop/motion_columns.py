"""Numbers of a motion's cycles, as arrays with one row per cycle."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.core.geometry import Array
from hil.core.signals import CycleRecord, Event


@dataclass(frozen=True)
class MotionColumns:
    """Numbers of n cycles; poses are (x m, y m, theta rad) of the body in the wall frame.

    Attributes:
        t_ns: (n,) time of each cycle's inputs, ns.
        rows: columns by name. `reference`: (n, 3) poses of the reference, NaN while only observing.
            `estimate`: (n, 3) estimated poses. `twist`: (n, 3) estimated body twists, m/s and rad/s.
            `covariance`: (n, 21) upper triangles of the covariances (6, 6) of pose and twist. `wheels`:
            (n, 8) aligned wheel angles, then steering angles, rad; NaN where they were not read.
        mocap_ns: (m,) stamps of the usable samples of motion capture, ns, in order of arrival.
        mocap: (m, 3) poses of these samples.
        diagnostics: (n,) values by name; NaN where a cycle has none.
        observers: (n, 3) poses by the name of a further estimator; NaN where a cycle has none.
        events: all events, oldest first.
    """

    t_ns: Array
    rows: Mapping[str, Array]
    mocap_ns: Array
    mocap: Array
    diagnostics: Mapping[str, Array]
    observers: Mapping[str, Array]
    events: tuple[Event, ...]

    def __len__(self) -> int:
        return len(self.t_ns)

    @classmethod
    def of(cls, records: Sequence[CycleRecord]) -> MotionColumns:
        """Numbers of some cycles."""
        states = [r.state for r in records]
        wheels = [r.measurements.wheels[-1] if r.measurements.wheels else None for r in records]
        poses = [m for r in records for m in r.measurements.mocap if m.valid]
        names = dict.fromkeys(name for state in states for name in state.diagnostics)
        ran = dict.fromkeys(name for r in records for name in r.observers)
        seen = {name: [r.observers.get(name) for r in records] for name in ran}
        covariances = np.array([state.covariance for state in states]).reshape(-1, 6, 6)
        return cls(
            np.array([r.inputs.t_ns for r in records], dtype=np.int64),
            {
                "reference": _rows([r.reference.pose_in_wall if r.reference else None for r in records], 3),
                "estimate": _rows([state.pose_body_in_wall for state in states], 3),
                "twist": _rows([state.twist_body for state in states], 3),
                "covariance": covariances[:, UPPER[0], UPPER[1]],
                "wheels": _rows(
                    [None if w is None else np.r_[w.wheel_angle_rad, w.steering_rad] for w in wheels], 8
                ),
            },
            np.array([m.stamp.t_ns for m in poses], dtype=np.int64),
            _rows([m.pose for m in poses], 3),
            {
                name: np.array([s.diagnostics.get(name, np.nan) for s in states], dtype=np.float64)
                for name in names
            },
            {k: _rows([None if s is None else s.pose_body_in_wall for s in v], 3) for k, v in seen.items()},
            tuple(event for r in records for event in r.events),
        )

    @classmethod
    def joined(cls, parts: Iterable[MotionColumns]) -> MotionColumns:
        """Numbers of successive stretches as those of one."""
        parts = tuple(parts) or (cls.of(()),)
        columns: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("t_ns", "mocap_ns", "mocap")
        }
        columns["rows"] = {
            name: np.concatenate([part.rows[name] for part in parts]) for name in parts[0].rows
        }
        columns["diagnostics"] = _joined([part.diagnostics for part in parts], [(len(p),) for p in parts])
        columns["observers"] = _joined([part.observers for part in parts], [(len(p), 3) for p in parts])
        return cls(**columns, events=tuple(event for part in parts for event in part.events))


UPPER = np.triu_indices(6)
"""Rows and columns of the upper triangle of a (6, 6) matrix."""


def _joined(parts: Sequence[Mapping[str, Array]], shapes: Sequence[tuple[int, ...]]) -> dict[str, Array]:
    names = dict.fromkeys(name for part in parts for name in part)
    filled = [(part, np.full(shape, np.nan)) for part, shape in zip(parts, shapes, strict=True)]
    return {name: np.concatenate([part.get(name, missing) for part, missing in filled]) for name in names}


def _rows(values: list[Array | None], width: int) -> Array:
    missing = np.full(width, np.nan)
    return np.array([missing if v is None else v for v in values], dtype=np.float64).reshape(-1, width)
