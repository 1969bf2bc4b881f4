"""What the doctor asks of motion capture: tracked frames, gaps, and latency."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from hil.core.clock import nanoseconds
from hil.core.finding import Finding, Level
from hil.core.signals import Status
from hil.devices.doctor_watch import LOSS_FAILURE, Watched

_LATE_S, _GAP_S = 0.05, 0.3


def look(watched: Watched) -> Iterator[Finding]:
    """Findings about motion capture that was watched."""
    samples, watch_s = watched.samples, watched.watch_s
    tracked = [s for s in samples if s.tracking_valid and s.status is Status.OK]
    share = len(tracked) / len(samples) if samples else 0.0
    now_ns = watched.clock.now_ns()
    seen_ns = [now_ns - nanoseconds(watch_s), *(s.stamp.host_ns for s in tracked), now_ns]
    gap_s = 1e-9 * max(b - a for a, b in pairwise(seen_ns))
    level: Level = "ok" if share > 1.0 - LOSS_FAILURE and gap_s < _GAP_S else "failure"
    told = (
        f"{len(tracked)} of {len(samples)} frames, {len(samples) / watch_s:.0f} Hz, longest gap {gap_s:.2f} s"
    )
    yield Finding(
        "mocap",
        "tracking",
        level,
        told,
        f"nearly all frames tracked, gaps below {_GAP_S:g} s",
        "check markers, occlusion and the rigid body's definition",
    )
    if tracked:
        latency_s = float(np.median([s.latency_s for s in tracked]))
        late = not math.isfinite(latency_s) or latency_s > _LATE_S
        yield Finding(
            "mocap",
            "latency",
            "warning" if late else "ok",
            f"{latency_s * 1e3:.1f} ms",
            f"below {_LATE_S * 1e3:g} ms",
            "use a wired network",
        )
