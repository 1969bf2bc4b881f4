"""Reports sensors that fall silent or send unusable samples: one event each."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.nonfinite import unmarked_nonfinite_fields
from hil.core.registry import further, kinds
from hil.core.signals import Event, Inputs, Status, samples_of, worst
from hil.loop.cycle_data import Check, Cycle

_OK = Status.OK
_FORGOTTEN_NS = 1_000_000_000
_MESSAGES = {
    Status.FROZEN: "repeats the same values to the last bit: frozen; not used",
    Status.IMPLAUSIBLE: "sends impossible values; not used",
    Status.NOT_FINITE: "sends NaN or infinity; not used",
    Status.JUMP: "has jumped; not used until it is steady",
    Status.RESET: "has started again",
    Status.HARDWARE_ERROR: "reports a hardware error; not used",
    Status.MAGNET: "reports a magnet that is too near or too far",
}
"""Statuses that are reported at once; a lost packet is not, only a silence."""


class SensorStatus(Check):
    """Checks status and age of the samples of one run.

    Args:
        stale_s: time without a good sample after which a sensor counts as silent, by sensor.
        gap_s: longest healthy time without a good sample, by sensor; a longer one is reported once a sensor
            has delivered.
        brought: sensors of other packages, and fields that they do not measure; all other fields of their
            samples are checked for NaN and infinity.
        lost_ns: time since the previous cycle in which a sensor could not be heard, ns, by sensor.
    """

    def __init__(
        self,
        stale_s: Mapping[str, float],
        gap_s: Mapping[str, float] | None = None,
        brought: Mapping[str, Collection[str]] | None = None,
        lost_ns: Callable[[str], int] = lambda name: 0,
    ) -> None:
        self._stale_ns = {name: nanoseconds(limit_s) for name, limit_s in stale_s.items()}
        warn_s = {**stale_s, **{k: min(gap, stale_s.get(k, gap)) for k, gap in (gap_s or {}).items()}}
        self._warn_ns = {name: nanoseconds(limit_s) for name, limit_s in warn_s.items()}
        known = kinds()
        self._channels = [
            (kind.name, samples_of(kind.name), kind.labels, kind.name in self._warn_ns)
            for kind in (known[name] for name in (*known, *further(self._warn_ns)))
            if not kind.moves_robot
        ]
        self._brought, self._lost_ns = brought or {}, lost_ns
        self.reset()

    def reset(self) -> None:
        """Clear ages and earlier reports."""
        self._last_ok_ns: dict[str, int] = {}
        self._last_bad: dict[str, Status] = {}
        self._last_any_ns: dict[str, int] = {}
        self._silent: set[str] = set()
        self._heard: set[str] = set()
        self._last_gap_ns: dict[str, int] = {}
        self._last_warn_ns: dict[tuple[str, Status], int] = {}
        self._holes: set[tuple[str, str]] = set()

    def on_samples(self, cycle: Cycle) -> None:
        """Check statuses and ages of this cycle's samples."""
        self.judge(cycle.inputs, cycle.events)

    def judge(self, inputs: Inputs, events: list[Event]) -> None:
        """Check one cycle's samples; adds findings to `events`."""
        t_ns = inputs.t_ns
        if inputs.lost_ns:
            self._excuse()
        for name, among, labels, ages in self._channels:
            good, samples = False, among(inputs)
            if not samples and not ages:
                continue
            for sample in samples:
                if sample.status is _OK:
                    good = True
                elif not labels:
                    self._last_bad[name] = sample.status
                    self._look(name, "", sample.status, t_ns, events)
                elif worst(sample) is _OK:
                    good = True
                else:
                    for label, status in zip(labels, sample.status, strict=True):
                        self._look(name, f"{label} ", status, t_ns, events)
            if name in self._brought:
                self._search(name, samples, t_ns, events)
            if ages:
                self._age(name, good, t_ns, events)
            if samples:
                last_ns, self._last_any_ns[name] = self._last_any_ns.get(name, t_ns), t_ns
                if not ages and t_ns - last_ns > _FORGOTTEN_NS:
                    events.append(Event(t_ns, "info", name, _again(t_ns - last_ns)))

    def _excuse(self) -> None:
        """Let time that this computer lost count for no sensor as silence."""
        for heard_ns in (self._last_ok_ns, self._last_any_ns):
            for name in heard_ns:
                heard_ns[name] += self._lost_ns(name)

    def _search(self, name: str, samples: Sequence[Any], t_ns: int, events: list[Event]) -> None:
        """Report each field with NaN or infinity and a good status once."""
        for sample in samples:
            for field in unmarked_nonfinite_fields(kinds()[name], sample, self._brought[name]):
                if (name, field) not in self._holes:
                    self._holes.add((name, field))
                    said = f"NaN or infinity in {field} with status ok: fix the driver of its package"
                    events.append(Event(t_ns, "warning", name, said))

    def silence(self, name: str, t_ns: int) -> str:
        """Text: time since the last good sample of a silent sensor, and its last bad status; else empty."""
        duration_ns = t_ns - self._last_ok_ns.get(name, t_ns)
        if name not in self._stale_ns or duration_ns <= self._stale_ns[name]:
            return ""
        duration_s = duration_ns / NS_PER_S
        bad = self._last_bad.get(name)
        return f"for {duration_s:.1f} s" + (" (nothing arrives)" if bad is None else f" ({bad.value})")

    def away_s(self, name: str, t_ns: int) -> float:
        """Time (s) since a sensor's last sample, good or bad; 0 before its first one."""
        return (t_ns - self._last_any_ns.get(name, t_ns)) / NS_PER_S

    def _look(self, name: str, part: str, status: Status, t_ns: int, events: list[Event]) -> None:
        if status in _MESSAGES:
            self._report(name, part, status, t_ns, events)

    def _report(self, name: str, part: str, status: Status, t_ns: int, events: list[Event]) -> None:
        key = (name + part, status)
        last_ns = self._last_warn_ns.get(key)
        self._last_warn_ns[key] = t_ns
        if last_ns is None or t_ns - last_ns > _FORGOTTEN_NS:
            events.append(Event(t_ns, "warning", name, part + _MESSAGES[status]))

    def _limit_ns(self, name: str) -> float:
        """Silence (ns) that is reported: shorter for a sensor that has delivered than for others."""
        limits = self._warn_ns if name in self._heard else self._stale_ns
        return limits.get(name, math.inf)

    def _age(self, name: str, good: bool, t_ns: int, events: list[Event]) -> None:
        last_ns = self._last_ok_ns.setdefault(name, t_ns)
        if good:
            self._heard.add(name)
            self._last_ok_ns[name] = t_ns
            self._last_bad.pop(name, None)
            if name in self._silent:
                self._silent.discard(name)
                events.append(Event(t_ns, "info", name, _again(t_ns - last_ns)))
        elif (
            t_ns - last_ns > self._limit_ns(name)
            and name not in self._silent
            and self._may_report(name, t_ns)
        ):
            self._silent.add(name)
            self._last_gap_ns[name] = t_ns
            events.append(Event(t_ns, "warning", name, f"stale for {(t_ns - last_ns) / NS_PER_S:.3f} s"))

    def _may_report(self, name: str, t_ns: int) -> bool:
        """Whether to report a gap: repeated gaps only once a second."""
        return t_ns - self._last_gap_ns.get(name, -_FORGOTTEN_NS) >= _FORGOTTEN_NS


def _again(gap_ns: int) -> str:
    return f"answers again, after {gap_ns / NS_PER_S:.2f} s"
