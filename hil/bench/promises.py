"""What the doctor says of a device of another package whose samples break a promise of every sensor."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from hil.devices.looks import Watched
from hil.vocabulary.clock import NS_PER_S, nanoseconds
from hil.vocabulary.finding import Finding
from hil.vocabulary.signals import Status

_EARLY_NS = nanoseconds(0.001)
_SHARE_OF_A_CYCLE = 0.5


def broken_promises(watched: Watched, waits_s: Sequence[float]) -> Iterator[Finding]:
    """One finding for each promise that is broken; nothing of a device that keeps them.

    Args:
        watched: the device and what it delivered.
        waits_s: how long each read took.
    """
    name, samples = watched.kind.name, watched.samples
    holes = {field for sample in samples for field in unsaid_holes(sample)}
    if holes:
        yield Finding(
            name, "numbers", "failure", f"NaN or infinity in {', '.join(sorted(holes))} with Status.OK",
            "a status that says why a number is missing", "mend read() of the package's driver",
        )  # fmt: skip
    ahead_ns = max((s.stamp.t_ns - s.stamp.host_ns for s in samples), default=0)
    ahead_ns = max(ahead_ns, max((s.stamp.host_ns for s in samples), default=0) - watched.clock.now_ns())
    if ahead_ns > _EARLY_NS:
        yield Finding(
            name, "stamps", "failure", f"up to {ahead_ns / NS_PER_S:.3g} s in the future",
            "t_ns, when it was measured, at most host_ns, when the host saw it",
            "take both from the clock that the driver was given",
        )  # fmt: skip
    usual_s = statistics.median(waits_s) if waits_s else 0.0
    if usual_s * watched.loop_hz > _SHARE_OF_A_CYCLE:
        yield Finding(
            name, "reads", "warning", f"read() takes {usual_s * 1e3:.3g} ms, usually",
            f"much less than a cycle of {1e3 / watched.loop_hz:.3g} ms",
            "return what has arrived, without waiting for the next sample",
        )  # fmt: skip


def unsaid_holes(sample: Any) -> Iterator[str]:
    """Fields of a sample that are not finite where its status says that they are good."""
    states = sample.status if isinstance(sample.status, tuple) else (sample.status,)
    good = np.array([state is Status.OK for state in states])
    for field in fields(sample):
        value = getattr(sample, field.name)
        if not isinstance(value, (float, np.ndarray)) or np.asarray(value).dtype.kind != "f":
            continue
        missing = ~np.isfinite(value)
        if np.ndim(missing) and len(missing) == len(good) > 1:
            missing = missing[good]
        elif not good.all():
            continue
        if missing.any():
            yield field.name
