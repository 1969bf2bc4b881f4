"""Calls user-supplied controllers and estimators, and checks their results.

Their inputs are read-only, because other estimators use them too and they are recorded. Their results are
checked in every cycle and copied, because they may be kept and changed later. A wrong result would otherwise
end the run much later, in code that the user does not know. Parts of this package are called directly.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from copy import copy
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, NoReturn, TypeVar

import numpy as np

from hil.core.errors import UsageError
from hil.core.geometry import Array
from hil.core.interfaces import Controller, Estimator
from hil.core.signals import Measurements, Reference, RobotState, WheelMeasurement, WheelSetpoint

T = TypeVar("T")
_SETPOINT = {"wheel_rate_rad_s": (4,), "steering_rad": (4,)}
_STATE = {"pose_body_in_wall": (3,), "twist_body": (3,), "covariance": (6, 6)}
_ROUNDING = 1e-6
"""Tolerated asymmetry of a covariance, relative to its largest element."""
_BITS = 63
"""Bits of a time stamp in recordings."""
_NUMBERS = (float, int, np.floating, np.integer, np.bool_)


def own_name(part: Any) -> str:
    """Module and class of a user-supplied part; empty for a part of this package, and for None."""
    kind: Any = type(part)
    return "" if part is None else _name_of(kind)


@lru_cache(maxsize=256)
def _name_of(kind: type[Any]) -> str:
    ours = kind.__module__.partition(".")[0] == "hil"
    return "" if ours else f"{kind.__module__}.{kind.__qualname__}"


def reset_estimator(estimator: Estimator, state: RobotState) -> None:
    """Reset an estimator to a state; a user-supplied one gets a copy that it may change."""
    estimator.reset(_copied(state, _STATE) if own_name(estimator) else state)


def checked_update(estimator: Estimator) -> Callable[[Measurements], RobotState]:
    """Update function of an estimator, which takes one cycle's measurements and returns a state.

    For a user-supplied estimator it raises `UsageError` if the result is no state, or has invalid fields.
    """
    return partial(_checked, estimator) if own_name(estimator) else estimator.update


def _checked(estimator: Estimator, measurements: Measurements) -> RobotState:
    given = replace(
        measurements,
        wheels=_sealed(measurements.wheels),
        gyro=_sealed(measurements.gyro),
        tracker=_sealed(measurements.tracker),
        mocap=_sealed(measurements.mocap),
    )
    found = estimator.update(given)
    wrong = _wrong_arrays(found, RobotState, _STATE) or _wrong_state(found)
    if wrong is not None:
        _refuse("estimator", estimator, measurements.cycle, *wrong)
    figures = {name: float(value) for name, value in found.diagnostics.items()}
    return _copied(found, _STATE, t_ns=int(found.t_ns), diagnostics=figures)


def call_controller(
    controller: Controller, cycle: int, state: RobotState, reference: Reference, wheels: WheelMeasurement
) -> WheelSetpoint:
    """Call a user-supplied controller and check its setpoint.

    Raises:
        UsageError: it returned no wheel setpoints, or invalid ones.
    """
    found = controller.update(*_sealed((state, reference, wheels)))
    wrong = _wrong_arrays(found, WheelSetpoint, _SETPOINT)
    wrong = wrong or _wrong_numbers(found)
    if wrong is not None:
        _refuse("controller", controller, cycle, *wrong)
    return _copied(found, _SETPOINT)


def _sealed(records: tuple[Any, ...]) -> tuple[Any, ...]:
    """Records with read-only views of the same arrays."""
    return tuple(map(_sealed_one, records))


def _sealed_one(record: T) -> T:
    sealed = copy(record)
    for name, value in vars(record).items():
        if isinstance(value, np.ndarray):
            seen = value.view()
            seen.flags.writeable = False
            sealed.__dict__[name] = seen
    return sealed


def _copied(record: T, arrays: Iterable[str], **others: object) -> T:
    """The record with copies of its arrays; extra attributes of a derived class are kept."""
    copied = copy(record)
    copies = {name: np.array(getattr(record, name), order="C") for name in arrays}
    copied.__dict__.update(copies, **others)
    return copied


def _wrong_arrays(
    found: object, kind: type[Any], shapes: Mapping[str, tuple[int, ...]]
) -> tuple[str, str] | None:
    """Found and expected, as texts, if a result is not of a class with arrays of these shapes."""
    wanted = " and ".join(f"{name} {shape}" for name, shape in shapes.items())
    expected = f"a {kind.__name__} with numpy arrays of float64: {wanted}"
    if not isinstance(found, kind):
        return _in_words(found), expected
    for name, shape in shapes.items():
        values = getattr(found, name)
        right = isinstance(values, np.ndarray) and values.shape == shape and values.dtype == np.float64
        if not right:
            return f"a {kind.__name__} whose {name} is {_in_words(values)}", expected
    return None


def _wrong_numbers(setpoint: WheelSetpoint) -> tuple[str, str] | None:
    """Found and expected, as of `_wrong_arrays`, for a number of a setpoint that is not finite."""
    for name in _SETPOINT:
        values: list[float] = getattr(setpoint, name).tolist()
        if not all(map(math.isfinite, values)):
            return f"a WheelSetpoint whose {name} is {values}", "finite numbers, rad/s and rad"
    return None


def _wrong_state(found: RobotState) -> tuple[str, str] | None:
    """Found and expected, for the other fields of a state and the symmetry of its covariance."""
    t_ns, figures = found.t_ns, found.diagnostics
    if not isinstance(t_ns, (int, np.integer)) or int(t_ns).bit_length() > _BITS:
        return f"a RobotState whose t_ns is {_in_words(t_ns)}", "whole nanoseconds"
    if not isinstance(figures, Mapping):
        return f"a RobotState whose diagnostics are {_in_words(figures)}", "a mapping of names to numbers"
    for name, value in figures.items():
        if not isinstance(name, str):
            return f"a RobotState whose diagnostics have a name {_in_words(name)}", "texts as names"
        if not isinstance(value, _NUMBERS) or math.isinf(value):
            message = f"a RobotState whose diagnostics[{name!r}] is {_in_words(value)}"
            return message, "a finite number, or NaN where there is none"
    off = _asymmetry(found.covariance)
    if off is not None:
        (i, k), here, there = off
        message = f"a RobotState whose covariance[{i}, {k}] is {here:g}, and [{k}, {i}] is {there:g}"
        return message, "a symmetric covariance"
    return None


def _asymmetry(p: Array) -> tuple[tuple[int, int], float, float] | None:
    """Largest asymmetry of a covariance (6, 6) beyond rounding: indices, element, opposite element.

    Elements that are not finite are ignored here: `hil.loop.checks.state_valid` checks them.
    """
    if (p == p.T).all() or not np.isfinite(p).all():
        return None
    apart = np.abs(p - p.T)
    if apart.max() <= _ROUNDING * np.abs(p).max():
        return None
    i, k = divmod(int(apart.argmax()), len(p))
    return (i, k), float(p[i, k]), float(p[k, i])


def _in_words(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape} and type {value.dtype}"
    return "None" if value is None else f"of type {type(value).__name__}: {value!r:.60}"


def _refuse(role: str, part: object, cycle: int, found: str, expected: str) -> NoReturn:
    message = f"{role} {type(part).__name__}: update() returned {found} (from cycle {cycle} on)"
    raise UsageError(message, expected=expected)
