"""Runs the checks of other packages: they are tried before a run; their errors name the package."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace

from hil.config.bench import BenchConfig
from hil.core.further_device import FurtherKind
from hil.core.registry import base_of, kinds
from hil.core.third_party_errors import OURS, PackageError, call_in_package, errors_as_package_error
from hil.loop.cycle_data import Check, Cycle, LastingCheck

_REASON = re.compile(r"[a-z][a-z0-9_]*")


class GuardedCheck(Check):
    """Wraps a check of another package, so that its exceptions name the package.

    Args:
        kind: the device's kind.
        package: name and version.
        check: the package's check.
    """

    def __init__(self, kind: str, package: str, check: Check) -> None:
        self._kind, self._package, self._check = kind, package, check

    def reset(self) -> None:
        """Reset the package's check."""
        with errors_as_package_error(self._kind, self._package, "reset() of its check"):
            self._check.reset()

    def on_samples(self, cycle: Cycle) -> None:
        """Call the check. Raises `PackageError`."""
        with errors_as_package_error(self._kind, self._package, "on_samples() of its check"):
            self._check.on_samples(cycle)
        self._reasons(cycle)

    def on_estimate(self, cycle: Cycle) -> None:
        """Call the check. Raises `PackageError`."""
        with errors_as_package_error(self._kind, self._package, "on_estimate() of its check"):
            self._check.on_estimate(cycle)
        self._reasons(cycle)

    def _reasons(self, cycle: Cycle) -> None:
        for reason, message in cycle.stops.items():
            if not (isinstance(reason, str) and _REASON.fullmatch(reason) and isinstance(message, str)):
                raise PackageError(
                    self._kind,
                    self._package,
                    f"its check stops with the reason {reason!r} and the message {message!r}",
                    expected="a reason in snake_case, such as battery_low, and a text",
                )


class AloneCheck(Check):
    """Wraps a kind's check for a further device: gives it inputs with the device's samples as the kind's.

    Passing a name would not suffice: code of the package calls `inputs.of("rangefinder")`.

    Args:
        kind: the further device.
        check: the kind's check.
    """

    def __init__(self, kind: FurtherKind, check: Check) -> None:
        self._kind, self._check = kind, check

    def reset(self) -> None:
        """Reset the package's check."""
        self._check.reset()

    def on_samples(self, cycle: Cycle) -> None:
        """Call the check; its messages name the device."""
        with self._alone(cycle):
            self._check.on_samples(cycle)

    def on_estimate(self, cycle: Cycle) -> None:
        """Call the check; its messages name the device."""
        with self._alone(cycle):
            self._check.on_estimate(cycle)

    @contextmanager
    def _alone(self, cycle: Cycle) -> Iterator[None]:
        inputs, measurements, stops = cycle.inputs, cycle.measurements, cycle.stops
        cycle.inputs, cycle.stops = self._kind.alone(inputs), {}
        cycle.measurements = replace(measurements, added=cycle.inputs.added)
        try:
            yield
        finally:
            found, cycle.stops = cycle.stops, stops
            cycle.inputs, cycle.measurements = inputs, measurements
        for reason, message in found.items():
            cycle.stop(reason, f"{self._kind.noun}: {message}" if isinstance(message, str) else message)


def added_checks(config: BenchConfig) -> Mapping[str, Sequence[Check]]:
    """New checks by kind.

    Raises:
        PackageError: a package returns an object that is not a check, or a check that can never stop.
    """
    return {name: checks_of(config, name) for name in config.devices()}


def checks_of(config: BenchConfig, name: str) -> Sequence[Check]:
    """New checks of one kind; raises as `added_checks`."""
    kind, table = kinds()[name], config.devices()[name]

    def own(check: Check) -> Check:
        return AloneCheck(kind, check) if isinstance(kind, FurtherKind) else check

    if kind.package == OURS:
        return tuple(own(check) for check in kind.checks(table))

    def refuse(found: object, expected: str) -> PackageError:
        return PackageError(name, kind.package, f"checks() gave {found!r:.80}", expected=expected)

    given = call_in_package(name, kind.package, "checks()", kind.checks, table)
    if not isinstance(given, (tuple, list)) or not all(isinstance(one, Check) for one in given):
        raise refuse(given, "a tuple of Check, of hil.devkit")
    there = {*config.devices(), base_of(name)}
    for one in given:
        if isinstance(one, LastingCheck) and one.kind not in there:
            raise refuse(one.kind, f"a LastingCheck of a kind of this bench: {', '.join(config.devices())}")
        if isinstance(one, LastingCheck) and not _REASON.fullmatch(str(one.reason)):
            raise refuse(one.reason, "a LastingCheck with a reason in snake_case, such as battery_low")
    return tuple(GuardedCheck(name, kind.package, own(one)) for one in given)
