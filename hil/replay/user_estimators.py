"""Estimators of the user's own for a replay: classes or functions, `FILE.py:NAME` or `MODULE:NAME`."""

from collections.abc import Iterator
from typing import cast

import numpy as np

from hil.bench.pipelines import BenchModel
from hil.core.errors import UsageError, did_you_mean
from hil.core.interfaces import Estimator
from hil.core.known_names import COMPARED
from hil.loop.checks.state_valid import unusable
from hil.loop.driven_motion import Motion
from hil.support.user_class import make_named

_PARTS = {"reset": ("state",), "update": ("measurements",)}
_EXPECTED = ", ".join(COMPARED) + ", or FILE.py:NAME or MODULE:NAME of your own"


def check_named(named: str) -> None:
    """Refuse what names neither a shipped estimator nor one in a file or module.

    Raises:
        UsageError: suggests a known name that is near.
    """
    if named in COMPARED or ":" in named:
        return
    is_file = named.endswith(".py")
    remedy = f"name the class in it, as {named}:NAME" if is_file else did_you_mean(named, COMPARED)
    raise UsageError(f"--estimator {named!r} is unknown", expected=_EXPECTED, remedy=remedy)


def make_own(named: str, bench: BenchModel) -> Estimator:
    """An estimator; NAME is called with the bench if it takes an argument, else with none.

    Raises:
        ConfigError: no such file, module or name, one that fails, or something without `reset` and `update`.
    """
    what = "reset(state), and update(measurements) that returns a RobotState"
    return cast("Estimator", make_named(named, "--estimator", _PARTS, bench, expected=what))


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
