"""Figures of the running loop twice a second, for a program that watches: bench, pose, devices, events.

No Rerun and no thread: figures that are due are passed on after the cycle, in time that the loop has left, as
plain values.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from hil.config.bench import BenchConfig
from hil.core.clock import NS_PER_S, Clock
from hil.core.event_rows import EventRows, event_lines
from hil.core.interfaces import HELD_NOTE, RUN_NOTE, Sink
from hil.core.kind_figures import KindFigures, Limited, unlimited
from hil.core.known_names import JOG
from hil.core.registry import kinds, sample_names
from hil.core.signals import KINDS, CycleRecord, Inputs, worst
from hil.core.watched_robot import WatchedRobot
from hil.monitor.stream_state import StreamLimits

_EVERY_NS = NS_PER_S // 2
_RATE_OVER = 3
"""Number of periods over which a rate is measured."""
_HEALTH = "health"
_OURS = (*KINDS, _HEALTH)

Tell = Callable[[str, Mapping[str, Any]], None]


class StatusStream(Sink):
    """Passes on pose and device states twice a second of the host's clock, also in virtual time.

    Args:
        tell: function that receives `("live", figures)`, `("watched", what is seen)` while the robot is
            watched without a loop, and `("held", how)` when a bench is closed.
        clock: the host's.
        config: configuration of the bench; its name, and whether its robot is real, are passed on, too.
        limited: time limit of the figures of a device's package, as of `KindFigures`.
    """

    def __init__(self, tell: Tell, clock: Clock, config: BenchConfig, limited: Limited = unlimited) -> None:
        self._tell, self._clock = tell, clock
        robot = "emulated" if "servos" in config.emulated() else "real"
        self._bench = {"bench": config.name, "robot": robot}
        self._next_ns = 0
        self._begun_ns: int | None = None
        self._due: tuple[CycleRecord, int] | None = None
        self._counts = dict.fromkeys(config.devices(), 0)
        self._limits = {name: StreamLimits.of(name, config) for name in config.devices()}
        self._loops = self._turns_joint = False
        self._latest: dict[str, tuple[Any, ...]] = {}
        self._figures_of = KindFigures(limited)
        self._told: deque[tuple[int, dict[str, int]]] = deque(maxlen=_RATE_OVER)
        self._events = EventRows()

    def write(self, record: CycleRecord) -> None:
        """Count the samples of one cycle, and note when figures are due."""
        if self._begun_ns is None:
            self._begun_ns = record.inputs.t_ns
        for name in sample_names(record.inputs):
            samples = record.inputs.of(name)
            if samples:
                self._counts[name] += len(samples)
                self._latest[name] = samples[-1:]
        if record.inputs.health:
            self._latest[_HEALTH] = record.inputs.health[-1:]
        for event in record.events:
            self._events.add(event, (event.t_ns - self._begun_ns) / NS_PER_S)
        now_ns = self._clock.now_ns()
        if now_ns >= self._next_ns:
            self._next_ns = now_ns + _EVERY_NS
            self._due = record, now_ns
        self._loops = True

    def rest(self) -> None:
        """Pass on the figures that are due."""
        due, self._due = self._due, None
        if due is not None:
            record, now_ns = due
            self._tell("live", self._figures(record) | {"host_s": now_ns / NS_PER_S})
            self._told.append((record.inputs.t_ns, dict(self._counts)))

    def watched(self, robot: WatchedRobot) -> None:
        """Pass on what is seen of the robot without a loop: at once, then twice a second."""
        self._due = None
        now_ns = self._clock.now_ns()
        if self._loops or now_ns >= self._next_ns:
            self._next_ns, self._loops = now_ns + _EVERY_NS, False
            events = event_lines(self._events.rows())
            told = {"words": str(robot), "events": events, "host_s": now_ns / NS_PER_S}
            self._tell("watched", {**asdict(robot), **told})

    def note(self, t_ns: int, kind: str, data: Mapping[str, object]) -> None:
        """Pass on how the robot was left; rates begin anew with each run of the loop."""
        if kind == HELD_NOTE:
            self._tell(HELD_NOTE, data)
        elif kind == RUN_NOTE:
            self._told.clear()
            self._turns_joint = str(data.get("controller")).startswith(JOG)

    def close(self) -> None:
        """Reset the time axis: the next bench has its own."""
        self._begun_ns = self._due = None
        self._told.clear()
        self._latest.clear()

    def _devices(self, inputs: Inputs) -> dict[str, dict[str, Any]]:
        """Rate, age, state and values of every device; a device that has sent nothing has none."""
        ours: dict[str, Any] = {name: value for name, value in self._latest.items() if name in _OURS}
        added = {name: value for name, value in self._latest.items() if name not in ours}
        newest = replace(inputs, **ours, added={**inputs.added, **added})
        return {name: self._device(name, newest) for name in self._counts}

    def _device(self, name: str, newest: Inputs) -> dict[str, Any]:
        samples, limits = self._latest.get(name, ()), self._limits[name]
        then_ns, before = self._told[0] if self._told else (newest.t_ns, self._counts)
        window_s = (newest.t_ns - then_ns) / NS_PER_S
        rate_hz = (self._counts[name] - before[name]) / window_s if window_s > 0.0 else None
        age_s = (newest.t_ns - samples[-1].stamp.t_ns) / NS_PER_S if samples else math.nan
        status = worst(samples[-1]) if samples else None
        told: dict[str, Any] = {
            "status": limits.state(status, age_s, rate_hz or 0.0, window_s),
            "rate_hz": _short(rate_hz),
            "due_hz": _number(limits.due_hz),
            "age_ms": _short(1e3 * age_s),
        }
        kind = kinds()[name]
        titles = {plot.entity: plot.title for plot in kind.plots}
        shown = self._figures_of(kind, newest) if samples else ()
        told["values"] = {
            titles.get(entity, entity): {key: _short(value) for key, value in figures.items()}
            for entity, figures in shown
        }
        return told

    def _figures(self, record: CycleRecord) -> dict[str, Any]:
        state, wheels = record.state, record.measurements.wheels
        since_ns = record.inputs.t_ns - (self._begun_ns or 0)
        return {
            **self._bench,
            "t_s": round(since_ns / NS_PER_S, 3),
            "pose": [None] * 3 if self._turns_joint else _plain(state.pose_body_in_wall),
            "twist": [None] * 3 if self._turns_joint else _plain(state.twist_body),
            "reference": None if record.reference is None else _plain(record.reference.pose_in_wall),
            "wheel_rad_s": _plain(wheels[-1].wheel_rate_rad_s) if wheels else None,
            "steering_rad": _plain(wheels[-1].steering_rad) if wheels else None,
            "adhesion_n": _number(state.diagnostics.get("adhesion_n")),
            "adhesion_needed_n": _number(state.diagnostics.get("adhesion_needed_n")),
            "devices": self._devices(record.inputs),
            "events": event_lines(self._events.rows()),
        }


def _plain(values: Sequence[float] | Any) -> list[float | None]:
    return [_number(value) for value in values]


def _short(value: float | None) -> float | None:
    """A value for a plot: five digits; None for what is unknown."""
    return None if value is None or not math.isfinite(value) else float(f"{value:.5g}")


def _number(value: float | None) -> float | None:
    """A figure as JSON has it; None for what is unknown."""
    return None if value is None or not math.isfinite(value) else round(float(value), 6)
