"""Findings of the doctor on samples of other packages that break the contract of every sensor."""

import statistics
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.finding import Finding
from hil.core.nonfinite import unmarked_nonfinite_fields
from hil.core.signals import Status, worst
from hil.drivers.doctor_watch import Watched

OLDEST_NS, EARLY_NS = nanoseconds(0.3), nanoseconds(0.001)
"""Largest time by which a sample may be measured before its arrival, and after it."""
_OLDER = 3.0
_SHARE_OF_A_CYCLE = 0.5


def find_contract_breaks(watched: Watched, waits_s: Sequence[float]) -> Iterator[Finding]:
    """One finding for each broken promise of the contract; none for a correct device.

    Args:
        watched: the device and its samples.
        waits_s: duration of each read, s.
    """
    name, samples = watched.kind.name, watched.samples
    holes = {
        field
        for sample in samples
        for field in unmarked_nonfinite_fields(watched.kind, sample, watched.not_measured)
    }
    if holes:
        yield Finding(
            name,
            "numbers",
            "failure",
            f"NaN or infinity in {', '.join(sorted(holes))} with Status.OK",
            "a status that says why a number is missing",
            "fix read() of the package's driver",
        )
    for field in changing(samples):
        yield Finding(
            name,
            "shapes",
            "failure",
            f"{field} changes its shape or its type from sample to sample",
            "one shape and type for as long as the device is open",
            "fix read() of the package's driver",
        )
    for found, expected in _wrong_stamps(watched):
        yield Finding(
            name, "stamps", "failure", found, expected, "take them from the clock that the driver was given"
        )
    usual_s = statistics.median(waits_s) if waits_s else 0.0
    if usual_s * watched.loop_hz > _SHARE_OF_A_CYCLE:
        yield Finding(
            name,
            "reads",
            "warning",
            f"read() takes {usual_s * 1e3:.3g} ms, usually",
            f"much less than a cycle of {1e3 / watched.loop_hz:.3g} ms",
            "return what has arrived, without waiting for the next sample",
        )


def changing(samples: Sequence[Any]) -> list[str]:
    """Names of sample fields of one device whose arrays change their shape or type."""
    forms: dict[str, set[tuple[Any, ...]]] = {}
    for sample in samples:
        for name, value in vars(sample).items():
            if isinstance(value, np.ndarray):
                forms.setdefault(name, set()).add((value.shape, value.dtype))
    return [name for name, seen in forms.items() if len(seen) > 1]


def _wrong_stamps(watched: Watched) -> Iterator[tuple[str, str]]:
    """Errors in stamps and sequence numbers of samples: found, and expected."""
    stamps = [s.stamp for s in watched.samples]
    good = [s.stamp for s in watched.samples if worst(s) is Status.OK]
    ahead_ns = max((s.t_ns - s.host_ns for s in stamps), default=0)
    ahead_ns = max(ahead_ns, max((s.host_ns for s in stamps), default=0) - watched.clock.now_ns())
    if ahead_ns > EARLY_NS:
        yield (
            f"up to {ahead_ns / NS_PER_S:.3g} s in the future",
            "t_ns, when it was measured, at most host_ns, when the host saw it",
        )
    limit_ns = max(OLDEST_NS, nanoseconds(_OLDER * watched.kind.max_age_s))
    age_ns = statistics.median(s.host_ns - s.t_ns for s in good) if good else 0
    if age_ns > limit_ns:
        yield (
            f"samples were measured {age_ns / NS_PER_S:.3g} s before they arrived, usually",
            f"at most {limit_ns / NS_PER_S:g} s",
        )
    back = sum(later.t_ns <= earlier.t_ns for earlier, later in pairwise(good))
    if back:
        yield (
            f"{back} of {len(good)} good samples were measured no later than the one before",
            "each later than the one before",
        )
    lower = sum(later.seq < earlier.seq for earlier, later in pairwise(stamps))
    if lower:
        yield f"{lower} of {len(stamps)} sequence numbers go back", "none lower than the one before"
