"""The boundary to the drivers of other packages: what they raise and return is checked and named here.

Drivers of this project are not wrapped. One of another package may raise anything and return anything;
behind a `Guarded` it raises `DeviceError`s that name the device and its package, and its samples are what
its kind says they are, so that the loop stops the robot and the recorder is not blamed.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import logging
import typing
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NoReturn

import numpy as np

from hil.bench.overdue import (
    AT_THE_END,
    BESIDE_CYCLES,
    IN_A_CYCLE,
    OverdueError,
    Patience,
    not_for_ever,
    opening,
)
from hil.recording.cycle_layout import DTYPES, MAX_DIMENSIONS, SHAPES
from hil.vocabulary.blame import OURS, PackageError, blamed
from hil.vocabulary.device import DeviceKind, DeviceModel
from hil.vocabulary.errors import HilError, told
from hil.vocabulary.geometry import Array
from hil.vocabulary.interfaces import Device
from hil.vocabulary.signals import Stamp, Status

LOG = logging.getLogger(__name__)

MOST_SAMPLES = 10_000
"""That one read may give: a second of the fastest device, many times over."""
_LEAST, _MOST = -(2**63), 2**63 - 1
_PLAIN: Mapping[Any, tuple[type[Any], ...]] = {
    float: (float, int, np.floating, np.integer),
    int: (int, np.integer),
    bool: (bool, np.bool_),
    str: (str,),
}

Wrong = Callable[[Any], str]
Failures = Mapping[str, HilError]


def guarded(
    kind: DeviceKind, model: DeviceModel, make: Callable[[], Device], failures: Failures, timeouts_s: float
) -> Device:
    """The driver that `make` makes; behind a `Guarded` where another package brings it."""
    return make() if model.package == OURS else Guarded(kind, model, make, failures, timeouts_s)


class Guarded:
    """A driver of another package.

    Args:
        kind: of the device.
        model: what brings the driver.
        make: makes it; where that fails, `open` says so, and other devices can still be examined.
        failures: by kind, what its emulated device has raised meanwhile (`hil.bench.guarded_parts`).
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
        self._ended: OverdueError | None = None
        try:
            with self._watched("its constructor", self._opening):
                self._driver = make()
        except HilError as error:
            self._failure = error
        name = getattr(self._driver, "name", None)
        self.name = name if isinstance(name, str) and name else kind.name
        self._checks = _checks(kind)

    def _blamed(self, what: str) -> Any:
        return blamed(self._kind.name, self._package, what)

    @contextmanager
    def _watched(self, what: str, patience: Patience) -> Iterator[None]:
        """Run code of the package that is to come back, and whose exceptions are its own."""
        with self._blamed(what), not_for_ever(self._kind.name, self._package, what, patience):
            yield

    def _blame(self, message: str, expected: str) -> NoReturn:
        raise PackageError(self._kind.name, self._package, message, expected=expected)

    def open(self) -> None:
        """Open the driver; raises why there is none."""
        if self._failure is not None:
            raise self._failure
        self._check_emulated()
        self._ended = None
        with self._watched("open()", self._opening):
            self._driver.open()

    def _check_emulated(self) -> None:
        """Raise what the emulated device has raised: here somebody is told of it who can do something."""
        if self._kind.name in self._failures:
            raise self._failures[self._kind.name]

    def close(self) -> None:
        """Close the driver. Never raises."""
        if self._driver is None:
            return
        try:
            with not_for_ever(self._kind.name, self._package, "close()", AT_THE_END):
                self._driver.close()
        except OverdueError as error:
            LOG.warning("%s", error)
        except (Exception, SystemExit, GeneratorExit) as error:
            LOG.warning("%s (%s): close() raised %s", self._kind.name, self._package, told(error))

    def identity(self) -> Mapping[str, str]:
        """What the driver says it found."""
        if self._driver is None:
            return {}
        with self._watched("identity()", AT_THE_END):
            found: Any = self._driver.identity()
        if not isinstance(found, Mapping):
            self._blame(f"identity() gave {_short(found)}", "texts by name, for example {'model': 'X1'}")
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
        except OverdueError as error:
            self._ended = error
            raise
        for sample in samples:
            if not isinstance(sample, self._kind.sample):
                self._blame(f"read() gave a {type(sample).__name__}: {_short(sample)}", wanted)
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
            self._blame(f"read() gave {_short(given)}", wanted)
        samples = tuple(itertools.islice(each, MOST_SAMPLES + 1))
        if len(samples) > MOST_SAMPLES:
            self._blame(
                f"read() gives more than {MOST_SAMPLES} samples, perhaps without end",
                "what has arrived since the last call",
            )
        return samples

    def __getattr__(self, name: str) -> Any:
        """Whatever else the driver has; its functions are blamed as the others are."""
        if name.startswith("_") or self._driver is None:
            raise AttributeError(name)
        found = getattr(self._driver, name)
        if not callable(found):
            return found

        patience = self._opening if name == "reopen" else BESIDE_CYCLES

        @functools.wraps(found)
        def call(*given: Any, **named: Any) -> Any:
            with self._watched(f"{name}()", patience):
                return found(*given, **named)

        return call


def _short(value: Any) -> str:
    try:
        text = repr(value)
    except Exception:  # of a class of the package, or of a number of thousands of digits
        return f"a {type(value).__name__}"
    return text if len(text) <= 60 else f"{text[:60]}..."


def _checks(kind: DeviceKind) -> list[tuple[str, str, Wrong]]:
    """Of each field of a kind's sample: its name, what is expected there, and what is wrong with a value."""
    shapes = SHAPES.get(kind.sample.__name__, {})
    found: list[tuple[str, str, Wrong]] = []
    for field, hint in typing.get_type_hints(kind.sample).items():
        if field == "stamp":
            found.append((field, "a Stamp of whole ns: Stamp(t_ns: int, host_ns: int, seq: int)", _of_stamp))
        elif field == "status" and (kind.labels or hint is not Status):
            many = f"{len(kind.labels)} Status: " if kind.labels else "Status"
            told = f"a tuple of {many}{', '.join(kind.labels)}, one for each channel"
            found.append((field, told, functools.partial(_of_status, len(kind.labels))))
        elif hint == Array:
            shape = shapes.get(field)
            told_shape = f" of shape {shape}" if shape else ""
            expected = f"a numpy array of float64, float32, int64 or bool{told_shape}"
            found.append((field, expected, functools.partial(_of_array, shape)))
        else:
            found.append((field, f"a {_written(hint)}", _of(hint)))
    return found


def _written(hint: Any) -> str:
    """A type hint as its author wrote it."""
    return hint.__name__ if isinstance(hint, type) and not typing.get_args(hint) else str(hint)


def _of(hint: Any) -> Wrong:
    """What is wrong with a value of this type hint, of those that a recording has a layout for."""
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return lambda value: ""
    if hint == Array:
        return functools.partial(_of_array, None)
    if hint in _PLAIN:
        return functools.partial(_of_plain, _PLAIN[hint])
    if origin is tuple:
        count = None if args[1:] == (...,) else len(args)
        return functools.partial(_of_tuple, count, _of(args[0]))
    if origin is Mapping or (isinstance(origin, type) and issubclass(origin, Mapping)):
        return functools.partial(_of_mapping, _of(args[1]))
    if type(None) in args:
        inner = _of(next(a for a in args if a is not type(None)))
        return lambda value: "" if value is None else inner(value)
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        inside = {name: _of(of) for name, of in typing.get_type_hints(hint).items()}
        return functools.partial(_of_class, hint, inside)
    return functools.partial(_of_plain, (hint,))


def _of_stamp(value: Any) -> str:
    if not isinstance(value, Stamp):
        return _short(value)
    for name in ("t_ns", "host_ns", "seq", "device_ns"):
        number = getattr(value, name)
        if (type(number) is not int or not _LEAST <= number <= _MOST) and (
            number is not None or name != "device_ns"
        ):
            return f"with {name} {_short(number)}"
    return ""


def _of_status(count: int, value: Any) -> str:
    if not isinstance(value, tuple) or not all(isinstance(state, Status) for state in value):
        return _short(value)
    return f"of length {len(value)}" if count and len(value) != count else ""


def _of_array(shape: tuple[int, ...] | None, value: Any) -> str:
    if not isinstance(value, np.ndarray):
        return _short(value)
    if value.dtype not in DTYPES.values() or value.ndim > MAX_DIMENSIONS:
        return f"of {value.dtype} with {value.ndim} dimensions"
    return "" if shape is None or value.shape == shape else f"of shape {value.shape}"


def _of_plain(types: tuple[type[Any], ...], value: Any) -> str:
    if not isinstance(value, types):
        return _short(value)
    if types is _PLAIN[int] and not _LEAST <= value <= _MOST:
        return f"{_short(value)}, which 64 bits do not hold"
    if types is _PLAIN[float] and not isinstance(value, float):
        try:
            float(value)
        except OverflowError:
            return f"{_short(value)}, which no float holds"
    return ""


def _of_tuple(count: int | None, wrong: Wrong, value: Any) -> str:
    good = isinstance(value, tuple) and count in (None, len(value)) and not any(map(wrong, value))
    return "" if good else _short(value)


def _of_mapping(wrong: Wrong, value: Any) -> str:
    good = isinstance(value, Mapping) and all(isinstance(key, str) for key in value)
    return "" if good and not any(map(wrong, value.values())) else _short(value)


def _of_class(kind: type[Any], inside: Mapping[str, Wrong], value: Any) -> str:
    good = isinstance(value, kind) and not any(wrong(getattr(value, name)) for name, wrong in inside.items())
    return "" if good else _short(value)
