"""States of the user's own estimator that a replay cannot use: warnings and problems, each in a sentence."""

from collections.abc import Iterator

import numpy as np

from hil.loop.checks.state_valid import unusable
from hil.loop.driven_motion import Motion


def unknown_states(name: str, motion: Motion) -> Iterator[str]:
    """A warning if poses or covariances of an estimator are not finite: figures leave them out."""
    known = np.isfinite(motion.estimate).all(axis=1) & np.isfinite(motion.covariance).all(axis=(1, 2))
    unknown = np.flatnonzero(~known)
    if len(unknown):
        yield (
            f"{name}: pose or covariance is not finite in {len(unknown)} of {len(motion.records)} cycles, "
            f"the first of them {motion.records[unknown[0]].cycle}; its figures are of the others"
        )


def unusable_states(name: str, motion: Motion) -> Iterator[str]:
    """A problem for each reason but NaN for which the loop would refuse states of an estimator."""
    found: dict[str, list[tuple[int, str]]] = {}
    for record in motion.records:
        if record.state is not None and (fault := unusable(record.state, record.inputs.t_ns)):
            found.setdefault(fault[0], []).append((record.cycle, fault[1]))
    for reason, cases in found.items():
        if reason != "not_finite":
            cycle, message = cases[0]
            yield f"{name}: {message} (cycle {cycle}; {len(cases)} of {len(motion.records)} cycles like this)"
