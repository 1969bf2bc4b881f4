"""One driven or observed motion: its cycle records, and arrays made from them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from hil.core.clock import NS_PER_S
from hil.core.errors import UsageError, did_you_mean
from hil.core.geometry import Array
from hil.core.interpolation import between_samples
from hil.core.signals import CycleRecord, Event, RobotState
from hil.loop.motion_columns import UPPER, MotionColumns

CAPTURE = "mocap"
LONGEST_GAP_S = 0.25
"""Longest gap between samples of motion capture that is interpolated.

Healthy capture systems lose the body for up to 0.2 s. Linear interpolation across 0.25 s is off by at
most 1.6 mm for followed references (0.2 m/s^2).
"""
HELD_S = 0.1
"""Longest use of the last sample, s: a frame in transit, a cycle, and a common gap (0.08 s) before it."""


@dataclass(frozen=True)
class Motion:
    """One run of the loop; arrays have one row per cycle, poses are (x m, y m, theta rad).

    Attributes:
        records: cycles of the run. Those of a long drive are on disk, and each pass reads them anew: the
            arrays are the quicker way to what they hold.
        known: numbers of these cycles, where they are known already.
    """

    records: Sequence[CycleRecord]
    known: MotionColumns | None = field(default=None, repr=False, compare=False)

    @cached_property
    def columns(self) -> MotionColumns:
        """Numbers of all cycles."""
        return MotionColumns.of(self.records) if self.known is None else self.known

    def then(self, following: Motion) -> Motion:
        """This motion and the one that followed it, as one."""
        columns = MotionColumns.joined((self.columns, following.columns))
        return Motion((*self.records, *following.records), columns)

    @property
    def t_s(self) -> Array:
        """Time since the first cycle, shape (n,), s."""
        t_ns = self.columns.t_ns
        return np.asarray((t_ns - t_ns[:1]) / NS_PER_S, dtype=np.float64)

    @property
    def reference(self) -> Array:
        """Reference poses in the wall frame, shape (n, 3); NaN while only observing."""
        return self.columns.rows["reference"]

    @property
    def estimate(self) -> Array:
        """Estimated poses of the body in the wall frame, shape (n, 3)."""
        return self.columns.rows["estimate"]

    @property
    def twist(self) -> Array:
        """Estimated body twist, shape (n, 3)."""
        return self.columns.rows["twist"]

    @property
    def covariance(self) -> Array:
        """Covariance of pose and twist, shape (n, 6, 6)."""
        rows, (up, across) = self.columns.rows["covariance"], UPPER
        full = np.empty((len(rows), 6, 6))
        full[:, up, across] = full[:, across, up] = rows
        return full

    @property
    def mocap(self) -> Array:
        """Motion-capture poses interpolated to the cycle times, shape (n, 3); NaN without believed samples.

        That is before the first sample, inside gaps longer than `LONGEST_GAP_S`, and more than `HELD_S` after
        the last sample.
        """
        columns = self.columns
        at_ns = columns.mocap_ns.astype(np.float64)
        order = np.argsort(at_ns, kind="stable")
        return between_samples(
            columns.t_ns.astype(np.float64),
            at_ns[order],
            columns.mocap[order],
            longest=LONGEST_GAP_S * NS_PER_S,
            after=HELD_S * NS_PER_S,
        )

    @property
    def truth(self) -> tuple[Array, str]:
        """Poses that the checks believe, shape (n, 3), and why they are not those of motion capture, if so.

        Where motion capture was left out, or its frame has moved, they are those of an estimate that uses the
        camera; without such an estimate NaN.
        """
        lost = next((e for e in self.events if e.distrusts and CAPTURE in e.suspects), None)
        if lost is None:
            return self.mocap, ""
        at_s = (lost.t_ns - self.records[0].inputs.t_ns) / NS_PER_S
        why = f"motion capture was left out {at_s:.2f} s after the start: {lost.message}"
        last = self.records[-1]
        fused = {name: state for name, state in (("", last.state), *last.observers.items()) if _uses(state)}
        if not fused:
            return np.full((len(self.records), 3), np.nan), f"not measured: {why}"
        name, state = next(iter(fused.items()))
        sigma_mm = 1e3 * math.sqrt(np.linalg.eigvalsh(state.covariance[:2, :2])[-1])
        poses = self.observer(name) if name else self.estimate
        return poses, f"by the estimate, with a sigma of {sigma_mm:.1f} mm at the end: {why}"

    @property
    def wheels(self) -> Array:
        """Aligned wheel angles then steering angles, shape (n, 8), rad; NaN where not read."""
        return self.columns.rows["wheels"]

    @property
    def events(self) -> tuple[Event, ...]:
        """All events in order."""
        return self.columns.events

    def diagnostic(self, name: str) -> Array:
        """One estimator diagnostic over time, shape (n,); NaN where absent."""
        found = self.columns.diagnostics.get(name)
        return np.full(len(self.columns), np.nan) if found is None else found

    def observer(self, name: str) -> Array:
        """Poses of a further estimator that ran in parallel with the one in the loop, (n, 3).

        Raises:
            UsageError: no estimator of that name ran.
        """
        ran = self.columns.observers
        if len(self.columns) and name not in ran:
            raise UsageError(
                f"no observer {name!r} ran beside this motion",
                expected="one of " + ", ".join(ran) if ran else "",
                remedy=did_you_mean(name, ran) or f"drive with observers=({name!r},)",
            )
        return ran.get(name, np.zeros((0, 3)))


def _uses(state: RobotState) -> bool:
    """Whether an estimate comes from the camera as well."""
    return "nis_mean_tracker" in state.diagnostics
