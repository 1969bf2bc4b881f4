"""Figures of the running loop twice a second, for a program that watches: bench, pose, devices, events.

No Rerun and no thread: figures that are due are passed on within the cycle, as plain values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from hil.config.bench import BenchConfig
from hil.core.clock import NS_PER_S, Clock
from hil.core.event_rows import EventRows, event_lines
from hil.core.interfaces import HELD_NOTE, Sink
from hil.core.registry import sample_names
from hil.core.signals import CycleRecord, Status, worst

_EVERY_NS = NS_PER_S // 2

Tell = Callable[[str, Mapping[str, Any]], None]


class StatusStream(Sink):
    """Passes on pose and device states twice a second of the host's clock, also in virtual time.

    Args:
        tell: function that receives `("live", figures)`, and `("held", how)` when a bench is closed.
        clock: the host's.
        config: configuration of the bench; its name, and whether its robot is real, are passed on, too.
    """

    def __init__(self, tell: Tell, clock: Clock, config: BenchConfig) -> None:
        self._tell, self._clock = tell, clock
        robot = "emulated" if "servos" in config.emulated() else "real"
        self._bench = {"bench": config.name, "robot": robot}
        self._next_ns = 0
        self._begun_ns: int | None = None
        self._counts: dict[str, int] = {}
        self._status: dict[str, Status] = {}
        self._events = EventRows()

    def write(self, record: CycleRecord) -> None:
        """Count the samples of one cycle; pass on the figures when they are due."""
        if self._begun_ns is None:
            self._begun_ns = record.inputs.t_ns
        for name in sample_names(record.inputs):
            samples = record.inputs.of(name)
            if samples:
                self._counts[name] = self._counts.get(name, 0) + len(samples)
                self._status[name] = worst(samples[-1])
        for event in record.events:
            self._events.add(event, (event.t_ns - self._begun_ns) / NS_PER_S)
        now_ns = self._clock.now_ns()
        if now_ns >= self._next_ns:
            self._next_ns = now_ns + _EVERY_NS
            self._tell("live", self._figures(record))
            self._counts = dict.fromkeys(self._counts, 0)

    def note(self, t_ns: int, kind: str, data: Mapping[str, object]) -> None:
        """Pass on how the robot was left."""
        if kind == HELD_NOTE:
            self._tell(HELD_NOTE, data)

    def close(self) -> None:
        """Reset the time axis: the next bench has its own."""
        self._begun_ns = None

    def _figures(self, record: CycleRecord) -> dict[str, Any]:
        state, wheels = record.state, record.measurements.wheels
        since_ns = record.inputs.t_ns - (self._begun_ns or 0)
        return {
            **self._bench,
            "t_s": round(since_ns / NS_PER_S, 3),
            "pose": _plain(state.pose_body_in_wall),
            "twist": _plain(state.twist_body),
            "reference": None if record.reference is None else _plain(record.reference.pose_in_wall),
            "wheel_rad_s": _plain(wheels[-1].wheel_rate_rad_s) if wheels else None,
            "steering_rad": _plain(wheels[-1].steering_rad) if wheels else None,
            "adhesion_n": _number(state.diagnostics.get("adhesion_n")),
            "adhesion_needed_n": _number(state.diagnostics.get("adhesion_needed_n")),
            "devices": {
                name: {"samples": count, "status": self._status[name].value}
                for name, count in self._counts.items()
            },
            "events": event_lines(self._events.rows()),
        }


def _plain(values: Sequence[float] | Any) -> list[float | None]:
    return [_number(value) for value in values]


def _number(value: float | None) -> float | None:
    """A figure as JSON has it; None for what is unknown."""
    return None if value is None or not math.isfinite(value) else round(float(value), 6)
