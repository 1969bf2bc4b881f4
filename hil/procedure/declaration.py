"""The declaration of a procedure: name, devices it needs, parameters, measurements, plan.

A procedure is a plain function of one argument, its `Context`:

    @procedure(name="short_line", needs=("servos",), measurements=(Measurement("end", "mm", high=30),))
    def run(ctx: Context) -> None:
        ...
"""

import hashlib
import inspect
import logging
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil.config.bench import BenchConfig
from hil.core.errors import ConfigError, UsageError, did_you_mean
from hil.core.registry import kinds
from hil.core.third_party_errors import of_a_script
from hil.procedure.measurements import Measurement, check_unique
from hil.procedure.parameters import check_model
from hil.robot.trajectories import Trajectory

Body = Callable[[Any], object]
"""Function of a procedure; its argument is a `hil.procedure.context.Context`."""
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
    """One planned step with the trajectories that it drives."""

    title: str
    trajectories: tuple[Trajectory, ...] = ()


@dataclass(frozen=True)
class Procedure:
    """A declared procedure.

    Attributes:
        name: name of the procedure, as in results.
        body: the function.
        needs: devices that it requires.
        parameters: dataclass or pydantic model with defaults.
        measurements: declared measurements, or a function that returns them from the parameters, or from
            parameters and bench configuration if limits depend on the bench.
        plan: steps and trajectories from parameters and bench configuration, for a dry run.
        teardown_s: time limit of each teardown action.
        bench: default profile, used when no bench is named.
        quick: parameters of its quick form (`hil run NAME --quick`); empty if it has none.
        summary: first line of the function's docstring.
        headline: function that makes a sentence about the outcome from the measured values by name; None
            for none. The sentence is left out if a value is missing.
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
        """Return the measurements for these parameters on a bench."""
        owner = f"procedure {self.name}"
        if not callable(self.measurements):
            return check_unique(self.measurements, owner)
        declare: Callable[..., Iterable[Measurement]] = self.measurements
        given = (parameters, config)[: len(inspect.signature(declare).parameters)]
        with of_a_script(f"measurements of {owner}"):
            return check_unique(declare(*given), owner)

    @property
    def file(self) -> Path | None:
        """Source file of the function; None for a callable that is not a function."""
        try:
            found = inspect.getsourcefile(inspect.unwrap(self.body))
        except TypeError:
            return None
        return None if found is None else Path(found).resolve()

    def script(self) -> dict[str, str] | None:
        """Return name and SHA-256 of the source file of the function; None without a readable file."""
        file = self.file
        if file is None:
            return None
        try:
            return {"file": file.name, "sha256": hashlib.sha256(file.read_bytes()).hexdigest()}
        except OSError:
            return None

    def perform(self, ctx: Any) -> None:
        """Run the function.

        Args:
            ctx: the `hil.procedure.context.Context` of the run.

        Raises:
            UsageError: the function returned a coroutine or a generator, whose body has not run.
        """
        returned = self.body(ctx)
        kind = _left_to_run(returned)
        if kind:
            if inspect.iscoroutine(returned):
                returned.close()
            raise _never_run(self.name, f"returned {kind}")

    def trajectories(self, parameters: Any, config: BenchConfig) -> Iterator[Trajectory]:
        """Yield the trajectories of the plan."""
        for step in self.steps(parameters, config):
            yield from step.trajectories

    def steps(self, parameters: Any, config: BenchConfig) -> tuple[PlannedStep, ...]:
        """Return the plan; without a plan, the step titles found in the function's source."""
        if self.plan is not None:
            with of_a_script(f"plan of procedure {self.name}"):
                return tuple(self.plan(parameters, config))
        try:
            source = inspect.getsource(self.body)
        except (OSError, TypeError):
            return ()
        return tuple(PlannedStep(m["title"]) for m in _STEP_CALL.finditer(source))

    def said(self, values: Mapping[str, float]) -> str:
        """Return the headline; empty if a value is missing or not a number.

        An exception in the headline function is logged, so that the results are not lost.
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
        """Return the parameters of a run: those of the quick form, if `quick`, overridden by the given ones.

        Raises:
            UsageError: the procedure has no quick form.
        """
        if quick and not self.quick:
            raise UsageError(
                f"procedure {self.name} has no quick form", remedy="leave --quick out, use --set"
            )
        return {**(self.quick if quick else {}), **given}

    def check_needs(self, config: BenchConfig) -> None:
        """Raise `ConfigError` that names required devices missing from the bench."""
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
        needs: devices that it requires.
        parameters: dataclass or pydantic model with defaults.
        measurements: declared measurements, or a function of parameters (and bench configuration).
        plan: steps and trajectories, for a dry run.
        teardown_s: time limit of each teardown action, s.
        bench: default profile, used when no bench is named.
        quick: parameters of its quick form.
        headline: function that makes a sentence about the outcome from the measured values by name.

    Raises:
        UsageError: invalid name, unknown device, `parameters` is not a class of parameters,
            `measurements` are contradictory or of a wrong type, or the body is not a plain function.
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
    """Raise `UsageError` unless `body` is a plain function: no coroutine or generator function."""
    if not callable(body):
        raise UsageError(f"procedure {name} is a {type(body).__name__}", expected=_PLAIN)
    if inspect.iscoroutinefunction(body):
        raise _never_run(name, "is an async function")
    if inspect.isgeneratorfunction(body) or inspect.isasyncgenfunction(body):
        raise _never_run(name, "is a generator function (it holds a yield)")


def _left_to_run(returned: object) -> str:
    """Return the kind of a returned coroutine or generator as text; empty for anything else."""
    if inspect.isawaitable(returned):
        return "something to await"
    return "a generator" if inspect.isgenerator(returned) or inspect.isasyncgen(returned) else ""


def _never_run(name: str, what: str) -> UsageError:
    return UsageError(
        f"procedure {name} {what}: a call of it runs nothing",
        expected=_PLAIN,
        remedy="write it without async and yield, or have it call asyncio.run",
    )
