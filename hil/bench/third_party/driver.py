"""The boundary to the drivers of other packages: what they raise and return is checked and named here.

Drivers of this project are not wrapped. One of another package may raise anything and return anything;
behind a `Guarded` it raises `DeviceError`s that name the device and its package, and its samples are what
its kind says they are, so that the loop stops the robot and the recorder is not blamed.
"""

from __future__ import annotations

import functools
import itertools
import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NoReturn

from hil.bench.third_party.call_timeout import (
    AT_THE_END,
    BESIDE_CYCLES,
    IN_A_CYCLE,
    CallTimeoutError,
    TimeLimit,
    opening,
    with_time_limit,
)
from hil.bench.third_party.sample_checks import checks_of, short
from hil.core.device import DeviceKind, DeviceModel
from hil.core.errors import HilError, error_text
from hil.core.interfaces import Device
from hil.core.package_errors import OURS, PackageError, blamed

LOG = logging.getLogger(__name__)

MOST_SAMPLES = 10_000
"""That one read may give: a second of the fastest device, many times over."""
Failures = Mapping[str, HilError]


def wrapped_driver(
    kind: DeviceKind, model: DeviceModel, make: Callable[[], Device], failures: Failures, timeouts_s: float
) -> Device:
    """The driver that `make` makes; wrapped in a `ThirdPartyDriver` where another package brings it."""
    return make() if model.package == OURS else ThirdPartyDriver(kind, model, make, failures, timeouts_s)


class ThirdPartyDriver:
    """A driver of another package.

    Args:
        kind: of the device.
        model: what brings the driver.
        make: makes it; where that fails, `open` says so, and other devices can still be examined.
        failures: by kind, what its emulated device has raised meanwhile (`hil.bench.third_party.emulated`).
        timeouts_s: what the time-outs of its table in the bench file come to; opening it may take as long.

    Attributes:
        name: the driver's own, or the kind's where it has none.
    """

    def __init__(
        self,
        kind: DeviceKind,
        model: DeviceModel,
        make: Callable[[], Device],
        failures: Failures,
        timeouts_s: float = 0.0,
    ) -> None:
        self._kind, self._package, self._failures = kind, model.package, failures
        self._opening = opening(timeouts_s)
        self._driver: Any = None
        self._failure: HilError | None = None
        self._ended: CallTimeoutError | None = None
        try:
            with self._watched("its constructor", self._opening):
                self._driver = make()
        except HilError as error:
            self._failure = error
        name = getattr(self._driver, "name", None)
        self.name = name if isinstance(name, str) and name else kind.name
        self._checks = checks_of(kind)

    def _blamed(self, what: str) -> Any:
        return blamed(self._kind.name, self._package, what)

    @contextmanager
    def _watched(self, what: str, limit: TimeLimit) -> Iterator[None]:
        """Run code of the package that is to come back, and whose exceptions are its own."""
        with self._blamed(what), with_time_limit(self._kind.name, self._package, what, limit):
            yield

    def _blame(self, message: str, expected: str) -> NoReturn:
        raise PackageError(self._kind.name, self._package, message, expected=expected)

    def open(self) -> None:
        """Open the driver; raises why there is none."""
        if self._failure is not None:
            raise self._failure
        self._check_emulated()
        self._ended = None
        try:
            with self._watched("open()", self._opening):
                self._driver.open()
        except HilError:
            self._check_emulated()  # one that has failed is why the driver finds nothing
            raise

    def _check_emulated(self) -> None:
        """Raise what the emulated device has raised: here the caller learns of it and can act."""
        if self._kind.name in self._failures:
            raise self._failures[self._kind.name]

    def close(self) -> None:
        """Close the driver. Never raises."""
        if self._driver is None:
            return
        try:
            with with_time_limit(self._kind.name, self._package, "close()", AT_THE_END):
                self._driver.close()
        except CallTimeoutError as error:
            LOG.warning("%s", error)
        except (Exception, SystemExit, GeneratorExit) as error:
            LOG.warning("%s (%s): close() raised %s", self._kind.name, self._package, error_text(error))

    def identity(self) -> Mapping[str, str]:
        """What the driver says it found."""
        if self._driver is None:
            return {}
        with self._watched("identity()", AT_THE_END):
            found: Any = self._driver.identity()
        if not isinstance(found, Mapping):
            self._blame(f"identity() gave {short(found)}", "texts by name, for example {'model': 'X1'}")
        return {str(key): str(value) for key, value in found.items()}

    def read(self) -> tuple[Any, ...]:
        """Samples of the driver, each of which is what the kind says.

        Raises:
            DeviceError: the driver's own, one that says what is wrong with its samples, or why there is no
                emulated device any more.
        """
        self._check_emulated()
        if self._ended is not None:
            raise self._ended
        wanted = f"a tuple of {self._kind.sample.__name__}, oldest first"
        try:
            with self._watched("read()", IN_A_CYCLE):
                samples = self._drained(wanted)
        except CallTimeoutError as error:
            self._ended = error
            raise
        for sample in samples:
            if not isinstance(sample, self._kind.sample):
                self._blame(f"read() gave a {type(sample).__name__}: {short(sample)}", wanted)
            for field, expected, wrong in self._checks:
                found = wrong(getattr(sample, field))
                if found:
                    self._blame(f"read() gave {self._kind.sample.__name__}.{field} {found}", expected)
        return samples

    def _drained(self, wanted: str) -> tuple[Any, ...]:
        given: Any = self._driver.read()
        try:
            each = iter(given)
        except TypeError:
            self._blame(f"read() gave {short(given)}", wanted)
        samples = tuple(itertools.islice(each, MOST_SAMPLES + 1))
        if len(samples) > MOST_SAMPLES:
            self._blame(
                f"read() gives more than {MOST_SAMPLES} samples, perhaps without end",
                "what has arrived since the last call",
            )
        return samples

    def __getattr__(self, name: str) -> Any:
        """Give all other attributes of the driver; errors of its functions name the package, too."""
        if name.startswith("_") or self._driver is None:
            raise AttributeError(name)
        found = getattr(self._driver, name)
        if not callable(found):
            return found

        limit = self._opening if name == "reopen" else BESIDE_CYCLES

        @functools.wraps(found)
        def call(*given: Any, **named: Any) -> Any:
            with self._watched(f"{name}()", limit):
                return found(*given, **named)

        return call
