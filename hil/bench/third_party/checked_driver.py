"""The boundary to the drivers of other packages: checks results, and makes exceptions name the package.

Drivers of this project are not wrapped. A driver of another package may raise or return anything. Its errors
are raised as `PackageError`, so that the loop stops the robot and the cause is not sought in the recorder.
Values are checked against the type hints of the fields of the kind's sample.
"""

import dataclasses
import functools
import itertools
import logging
import typing
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NoReturn

import numpy as np

from hil.bench.third_party.call_timeout import (
    AT_THE_END,
    BESIDE_CYCLES,
    IN_A_CYCLE,
    CallTimeoutError,
    TimeLimit,
    opening,
    with_time_limit,
)
from hil.core.device import DeviceKind, DeviceModel
from hil.core.errors import HilError, error_text
from hil.core.geometry import Array
from hil.core.interfaces import Device
from hil.core.signals import Stamp, Status
from hil.core.third_party_errors import OURS, PackageError, errors_as_package_error
from hil.recording.cycle_codec import DTYPES

_LEAST, _MOST = -(2**63), 2**63 - 1
_PLAIN: Mapping[Any, tuple[type[Any], ...]] = {
    float: (float, int, np.floating, np.integer),
    int: (int, np.integer),
    bool: (bool, np.bool_),
    str: (str,),
}

_SERVOS, _WHEELS, _VECTOR, _QUATERNION = (8,), (4,), (3,), (4,)
_SHAPES: Mapping[str, Mapping[str, tuple[int, ...]]] = {
    "ServoSample": dict.fromkeys(("position_rad", "velocity_rad_s", "current_a"), _SERVOS),
    "EncoderSample": {"angle_rad": _WHEELS},
    "ImuSample": {"quaternion_wxyz": _QUATERNION}
    | dict.fromkeys(("gyro_rad_s", "linear_acceleration_m_s2", "gravity_m_s2"), _VECTOR),
    "TrackerSample": {"quaternion_wxyz": _QUATERNION}
    | dict.fromkeys(("position_m", "velocity_m_s", "angular_velocity_rad_s"), _VECTOR),
    "MocapSample": {"position_m": _VECTOR, "quaternion_wxyz": _QUATERNION},
    "LoadCellSample": {"force_n": (2,)},
}
"""Array shapes defined in `hil.core.signals`, by sample and field."""

Wrong = Callable[[Any], str]
LOG = logging.getLogger(__name__)
MOST_SAMPLES = 10_000
"""Largest number of samples in one read: many times that of the fastest device in a second."""
Failures = Mapping[str, HilError]


def short(value: Any) -> str:
    """A value for a message: the first 60 characters of its `repr`."""
    try:
        text = repr(value)
    except Exception:  # `repr` of a package's class, or of a number with thousands of digits, may fail
        return f"a {type(value).__name__}"
    return text if len(text) <= 60 else f"{text[:60]}..."


def checks_of(kind: DeviceKind) -> list[tuple[str, str, Wrong]]:
    """(name, expected, check of a value) for each field of a kind's sample."""
    shapes = _SHAPES.get(kind.sample.__name__, {})
    found: list[tuple[str, str, Wrong]] = []
    for field, hint in typing.get_type_hints(kind.sample).items():
        if field == "stamp":
            found.append((field, "a Stamp of whole ns: Stamp(t_ns: int, host_ns: int, seq: int)", _of_stamp))
        elif field == "status" and (kind.labels or hint is not Status):
            many = f"{len(kind.labels)} Status: " if kind.labels else "Status"
            message = f"a tuple of {many}{', '.join(kind.labels)}, one for each channel"
            found.append((field, message, functools.partial(_of_status, len(kind.labels))))
        elif hint == Array:
            shape = shapes.get(field)
            shape_text = f" of shape {shape}" if shape else ""
            expected = f"a numpy array of float64, float32, int64 or bool{shape_text}"
            found.append((field, expected, functools.partial(_of_array, shape)))
        else:
            found.append((field, f"a {_written(hint)}", _of(hint)))
    return found


def _written(hint: Any) -> str:
    """A type hint as text, as written in the source."""
    return hint.__name__ if isinstance(hint, type) and not typing.get_args(hint) else str(hint)


def _of(hint: Any) -> Wrong:
    """Make the check of a value against a type hint, for types that can be recorded."""
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
        return short(value)
    for name in ("t_ns", "host_ns", "seq", "device_ns"):
        number = getattr(value, name)
        if (type(number) is not int or not _LEAST <= number <= _MOST) and (
            number is not None or name != "device_ns"
        ):
            return f"with {name} {short(number)}"
    return ""


def _of_status(count: int, value: Any) -> str:
    if not isinstance(value, tuple) or not all(isinstance(state, Status) for state in value):
        return short(value)
    return f"of length {len(value)}" if count and len(value) != count else ""


def _of_array(shape: tuple[int, ...] | None, value: Any) -> str:
    if not isinstance(value, np.ndarray):
        return short(value)
    if value.dtype not in DTYPES:
        return f"of {value.dtype}"
    return "" if shape is None or value.shape == shape else f"of shape {value.shape}"


def _of_plain(types: tuple[type[Any], ...], value: Any) -> str:
    if not isinstance(value, types):
        return short(value)
    if types is _PLAIN[int] and not _LEAST <= value <= _MOST:
        return f"{short(value)}, which 64 bits do not hold"
    if types is _PLAIN[float] and not isinstance(value, float):
        try:
            float(value)
        except OverflowError:
            return f"{short(value)}, which no float holds"
    return ""


def _of_tuple(count: int | None, wrong: Wrong, value: Any) -> str:
    good = isinstance(value, tuple) and count in (None, len(value)) and not any(map(wrong, value))
    return "" if good else short(value)


def _of_mapping(wrong: Wrong, value: Any) -> str:
    good = isinstance(value, Mapping) and all(isinstance(key, str) for key in value)
    return "" if good and not any(map(wrong, value.values())) else short(value)


def _of_class(kind: type[Any], inside: Mapping[str, Wrong], value: Any) -> str:
    good = isinstance(value, kind) and not any(wrong(getattr(value, name)) for name, wrong in inside.items())
    return "" if good else short(value)


def wrapped_driver(
    kind: DeviceKind, model: DeviceModel, make: Callable[[], Device], failures: Failures, timeouts_s: float
) -> Device:
    """Make a driver; wrap it in a `ThirdPartyDriver` if another package provides its model."""
    return make() if model.package == OURS else ThirdPartyDriver(kind, model, make, failures, timeouts_s)


class ThirdPartyDriver:
    """Wraps a driver of another package.

    Args:
        kind: the device's kind.
        model: the device's model.
        make: function that makes the driver; if it fails, `open` raises its error, and other devices can
            still be examined.
        failures: errors of emulated devices so far, by kind (`hil.bench.third_party.checked_emulation`).
        timeouts_s: sum of the timeouts in its table of the bench file; opening may take as long.

    Attributes:
        name: the driver's own name, or the kind's if it has none.
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
        return errors_as_package_error(self._kind.name, self._package, what)

    @contextmanager
    def _watched(self, what: str, limit: TimeLimit) -> Iterator[None]:
        """Run code of the package under a time limit; its exceptions become `PackageError`."""
        with self._blamed(what), with_time_limit(self._kind.name, self._package, what, limit):
            yield

    def _blame(self, message: str, expected: str) -> NoReturn:
        raise PackageError(self._kind.name, self._package, message, expected=expected)

    def open(self) -> None:
        """Open the driver. Raises the error of its constructor if it could not be made."""
        if self._failure is not None:
            raise self._failure
        self._check_emulated()
        self._ended = None
        try:
            with self._watched("open()", self._opening):
                self._driver.open()
        except HilError:
            self._check_emulated()  # if the emulated device has failed, that is the cause
            raise

    def _check_emulated(self) -> None:
        """Raise the stored error of the emulated device, so that the caller can react to it."""
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
        """Identity that the driver reports, checked."""
        if self._driver is None:
            return {}
        with self._watched("identity()", AT_THE_END):
            found: Any = self._driver.identity()
        if not isinstance(found, Mapping):
            self._blame(f"identity() gave {short(found)}", "texts by name, for example {'model': 'X1'}")
        return {str(key): str(value) for key, value in found.items()}

    def read(self) -> tuple[Any, ...]:
        """Samples of the driver, checked against the kind's sample type.

        Raises:
            DeviceError: raised by the driver, for wrong samples, or for a failed emulated device.
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
        """All other attributes of the driver; errors of its functions name the package, too."""
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
