"""The declaration of a procedure: name, devices it needs, parameters, measurements, plan.

A procedure is a plain function of one argument, its `Context`:

    @procedure(name="short_line", needs=("servos",), measurements=(Measurement("end", "mm", high=30),))
    def run(ctx: Context) -> None:
        ...
"""

from __future__ import annotations

import hashlib
import inspect
import logging
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.config.bench import BenchConfig
from hil.core.errors import ConfigError, UsageError, did_you_mean
from hil.core.package_errors import of_a_script
from hil.core.registry import kinds
from hil.procedure.measurements import Measurement, check_unique
from hil.procedure.parameters import check_model
from hil.robot.trajectories import Trajectory

if TYPE_CHECKING:
    from hil.procedure.context import Context

Body = Callable[["Context"], object]
Plan = Callable[[Any, BenchConfig], Iterable["PlannedStep"]]
Declare = Callable[[Any], Iterable[Measurement]] | Callable[[Any, BenchConfig], Iterable[Measurement]]
Measurements = Sequence[Measurement] | Declare
Headline = Callable[[Mapping[str, float]], str]

LOG = logging.getLogger(__name__)

_NAME = re.compile(r"[a-z][a-z0-9_]*")
_STEP_CALL = re.compile(r"\.(?:step|checkpoint)\(\s*(?P<f>f?)[\"'](?P<title>[^\"']+)[\"']")


@dataclass(frozen=True)
class NoParameters:
    """Parameters of a procedure that has none."""


@dataclass(frozen=True)
class PlannedStep:
    """One step as announced before the run, with the trajectories that it drives."""

    title: str
    trajectories: tuple[Trajectory, ...] = ()


@dataclass(frozen=True)
class Procedure:
    """A declared procedure.

    Attributes:
        name: of the procedure, as in results.
        body: the function.
        needs: devices without which it cannot run.
        parameters: dataclass or pydantic model with defaults.
        measurements: what it measures, or a function that says so of the parameters, or of parameters and
            bench configuration where limits depend on the bench.
        plan: steps and trajectories from parameters and bench configuration, for a dry run.
        teardown_s: time limit of each teardown action.
        bench: profile that it runs on when no bench is named.
        quick: parameters of its quick form (`hil run NAME --quick`); empty for one that has none.
        summary: first line of the function's docstring.
        headline: what a run showed, as a sentence, from its measured values by name; None for none. One
            that misses a value says nothing.
    """

    name: str
    body: Body
    needs: tuple[str, ...] = ()
    parameters: type[Any] = NoParameters
    measurements: Measurements = ()
    plan: Plan | None = None
    teardown_s: float = 30.0
    bench: str = "emulated"
    quick: Mapping[str, Any] = field(default_factory=dict)
    summary: str = ""
    headline: Headline | None = None

    def declared(self, parameters: Any, config: BenchConfig) -> tuple[Measurement, ...]:
        """The measurements that these parameters call for on a bench."""
        owner = f"procedure {self.name}"
        if not callable(self.measurements):
            return check_unique(self.measurements, owner)
        declare: Callable[..., Iterable[Measurement]] = self.measurements
        given = (parameters, config)[: len(inspect.signature(declare).parameters)]
        with of_a_script(f"measurements of {owner}"):
            return check_unique(declare(*given), owner)

    @property
    def file(self) -> Path | None:
        """Where the function is written; None for what is called and is no function."""
        try:
            found = inspect.getsourcefile(inspect.unwrap(self.body))
        except TypeError:
            return None
        return None if found is None else Path(found).resolve()

    def script(self) -> dict[str, str] | None:
        """Name and SHA-256 of the file that the function is written in; None where there is none to read."""
        file = self.file
        if file is None:
            return None
        try:
            return {"file": file.name, "sha256": hashlib.sha256(file.read_bytes()).hexdigest()}
        except OSError:
            return None

    def perform(self, ctx: Context) -> None:
        """Run the function.

        Raises:
            UsageError: it has returned a coroutine or a generator, of which nothing has been run.
        """
        returned = self.body(ctx)
        kind = _left_to_run(returned)
        if kind:
            if inspect.iscoroutine(returned):
                returned.close()
            raise _never_run(self.name, f"returned {kind}")

    def steps(self, parameters: Any, config: BenchConfig) -> tuple[PlannedStep, ...]:
        """The plan; without one, the titles written in the function's source."""
        if self.plan is not None:
            with of_a_script(f"plan of procedure {self.name}"):
                return tuple(self.plan(parameters, config))
        try:
            source = inspect.getsource(self.body)
        except (OSError, TypeError):
            return ()
        return tuple(PlannedStep(m["title"]) for m in _STEP_CALL.finditer(source))

    def said(self, values: Mapping[str, float]) -> str:
        """The headline; empty where it misses a value, or one that is no number.

        A fault in it must not cost the results.
        """
        known = {name: value for name, value in values.items() if math.isfinite(value)}
        try:
            return "" if self.headline is None else str(self.headline(known))
        except KeyError:
            return ""
        except (Exception, SystemExit, GeneratorExit) as problem:
            LOG.warning("the headline of %s failed (%s: %s)", self.name, type(problem).__name__, problem)
            return ""

    def settings(self, given: Mapping[str, Any], *, quick: bool) -> dict[str, Any]:
        """Parameters to run with: those given, over those of the quick form where that is asked for.

        Raises:
            UsageError: it has no quick form.
        """
        if quick and not self.quick:
            raise UsageError(
                f"procedure {self.name} has no quick form", remedy="leave --quick out, use --set"
            )
        return {**(self.quick if quick else {}), **given}

    def check_needs(self, config: BenchConfig) -> None:
        """Raise `ConfigError` naming the devices that the bench lacks."""
        missing = [n for n in self.needs if getattr(config, n, None) is None]
        if missing:
            raise ConfigError(
                f"procedure {self.name} needs {', '.join(missing)}, which the bench {config.name!r} lacks",
                remedy="add the section(s) to the bench file, or choose another bench",
            )


def procedure(
    *,
    name: str,
    needs: Sequence[str] = (),
    parameters: type[Any] = NoParameters,
    measurements: Measurements = (),
    plan: Plan | None = None,
    teardown_s: float = 30.0,
    bench: str = "emulated",
    quick: Mapping[str, Any] | None = None,
    headline: Headline | None = None,
) -> Callable[[Body], Procedure]:
    """Declare a function as a procedure.

    Args:
        name: small letters, digits, underscores.
        needs: devices without which it cannot run.
        parameters: dataclass or pydantic model with defaults.
        measurements: what it measures, or a function of parameters (and bench configuration) that says so.
        plan: steps and trajectories, for a dry run.
        teardown_s: time limit of each teardown action, s.
        bench: profile that it runs on when no bench is named.
        quick: parameters of its quick form.
        headline: what a run showed, as a sentence, from its measured values by name.

    Raises:
        UsageError: a name or device that does not exist, parameters that are no class of them,
            measurements that contradict themselves or are none, or what is no plain function.
    """
    if not _NAME.fullmatch(name):
        raise UsageError(f"procedure name {name!r}", expected="lower case letters, digits and _")
    for device in needs:
        if device not in kinds():
            raise UsageError(
                f"procedure {name} needs {device!r}",
                expected="some of " + ", ".join(kinds()),
                remedy=did_you_mean(device, kinds()) or "install the package that adds this kind of device",
            )
    check_model(parameters, name)
    if not callable(measurements):
        check_unique(measurements, f"procedure {name}")

    def declare(body: Body) -> Procedure:
        _check_body(body, name)
        summary = (inspect.getdoc(body) or "").partition("\n")[0]
        return Procedure(
            name,
            body,
            tuple(needs),
            parameters,
            measurements,
            plan,
            teardown_s,
            bench,
            dict(quick or {}),
            summary,
            headline,
        )

    return declare


_PLAIN = "a plain function of one argument: def run(ctx)"


def _check_body(body: object, name: str) -> None:
    """Refuse what is no function, and one of which a call runs nothing; raises `UsageError`."""
    if not callable(body):
        raise UsageError(f"procedure {name} is a {type(body).__name__}", expected=_PLAIN)
    if inspect.iscoroutinefunction(body):
        raise _never_run(name, "is an async function")
    if inspect.isgeneratorfunction(body) or inspect.isasyncgenfunction(body):
        raise _never_run(name, "is a generator function (it holds a yield)")


def _left_to_run(returned: object) -> str:
    """What a function has returned instead of having done it, in words; empty for anything else."""
    if inspect.isawaitable(returned):
        return "something to await"
    return "a generator" if inspect.isgenerator(returned) or inspect.isasyncgen(returned) else ""


def _never_run(name: str, what: str) -> UsageError:
    return UsageError(
        f"procedure {name} {what}: a call of it runs nothing",
        expected=_PLAIN,
        remedy="write it without async and yield, or have it call asyncio.run",
    )
