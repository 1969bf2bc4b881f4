"""Estimators of the user's own for a replay: classes or functions in a Python file, named `FILE.py:NAME`."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import numpy as np

from hil.bench.model import BenchModel
from hil.core.choices import COMPARED
from hil.core.errors import ConfigError, UsageError, did_you_mean
from hil.core.interfaces import Estimator
from hil.core.package_errors import of_a_script
from hil.loop.recorded_motion import Motion
from hil.support.script_file import run_file

_PARTS = ("reset", "update")
_EXPECTED = ", ".join(COMPARED) + ", or FILE.py:NAME of your own"


def check_named(named: str) -> None:
    """Refuse what names neither a shipped estimator nor one in a Python file.

    Raises:
        UsageError: names what is meant, where it is near.
    """
    file, _, _ = named.partition(".py:")
    if named in COMPARED or file != named:
        return
    is_file = named.endswith(".py")
    remedy = f"name the class in it, as {named}:NAME" if is_file else did_you_mean(named, COMPARED)
    raise UsageError(f"--estimator {named!r} is unknown", expected=_EXPECTED, remedy=remedy)


def make_own(named: str, bench: BenchModel) -> Estimator:
    """The estimator `FILE.py:NAME`; NAME is called with the bench if it takes an argument, else with none.

    Raises:
        ConfigError: no such file or name, one that fails, or something without `reset` and `update`.
    """
    stem, _, name = named.partition(".py:")
    path = Path(f"{stem}.py")
    if not path.is_file():
        raise ConfigError(f"--estimator {named}: {path}: no such file", expected=_EXPECTED)
    make = _maker(run_file(path), name, named)
    with of_a_script(f"--estimator {named}: {name}()"):
        made = make(bench) if _needs_one(make) else make()
    missing = [part for part in _PARTS if not callable(getattr(made, part, None))]
    if missing:
        raise ConfigError(
            f"--estimator {named}: what {name}() makes has no {' and no '.join(missing)}",
            expected="reset(state), and update(measurements) that returns a RobotState",
        )
    return cast("Estimator", made)


def unknown_states(name: str, motion: Motion) -> Iterator[str]:
    """One line where poses or covariances of an estimator are not finite: they are in no figure."""
    known = np.isfinite(motion.estimate).all(axis=1) & np.isfinite(motion.covariance).all(axis=(1, 2))
    unknown = np.flatnonzero(~known)
    if len(unknown):
        yield (
            f"{name}: pose or covariance is not finite in {len(unknown)} of {len(motion.records)} cycles, "
            f"the first of them {motion.records[unknown[0]].cycle}; its figures are of the others"
        )


def _maker(module: ModuleType, name: str, named: str) -> Callable[..., Any]:
    make = getattr(module, name, None)
    if callable(make):
        return cast("Callable[..., Any]", make)
    there = [
        key
        for key, value in vars(module).items()
        if inspect.isclass(value) and all(callable(getattr(value, part, None)) for part in _PARTS)
    ]
    raise ConfigError(
        f"--estimator {named}: the file has no class or function {name!r}",
        expected="one of " + ", ".join(there) if there else "a class with reset and update",
        remedy=did_you_mean(name, there),
    )


def _needs_one(make: Callable[..., Any]) -> bool:
    """Whether a call needs an argument by its place."""
    by_place = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    taken = inspect.signature(make).parameters.values()
    return any(one.kind in by_place and one.default is one.empty for one in taken)
