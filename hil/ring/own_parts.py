"""Controllers and estimators of one's own: what they are called, and what is wrong with what they return.

A wrong result would otherwise end the run much later, in code that its author does not know.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hil.vocabulary.errors import UsageError
from hil.vocabulary.signals import RobotState, WheelSetpoint

_SETPOINT = {"wheel_rate_rad_s": (4,), "steering_rad": (4,)}
_STATE = {"pose_body_in_wall": (3,), "twist_body": (3,), "covariance": (6, 6)}


def own_name(part: object | None) -> str:
    """Module and class of a part that is not of this package; empty for ours, and for none."""
    kind = type(part)
    if part is None or kind.__module__.partition(".")[0] == "hil":
        return ""
    return f"{kind.__module__}.{kind.__qualname__}"


def check_setpoint(controller: object, found: object) -> None:
    """Raise `UsageError` unless a controller has returned wheel setpoints."""
    _check("controller", controller, found, WheelSetpoint, _SETPOINT)


def check_state(estimator: object, found: object) -> None:
    """Raise `UsageError` unless an estimator has returned a state."""
    _check("estimator", estimator, found, RobotState, _STATE)
    t_ns = getattr(found, "t_ns", None)
    if not isinstance(t_ns, (int, np.integer)):
        _refuse("estimator", estimator, f"a RobotState whose t_ns is {_in_words(t_ns)}", "whole nanoseconds")
    diagnostics = getattr(found, "diagnostics", None)
    if not isinstance(diagnostics, Mapping):
        told = f"a RobotState whose diagnostics are {_in_words(diagnostics)}"
        _refuse("estimator", estimator, told, "a mapping of names to numbers")


def _check(
    role: str, part: object, found: object, kind: type[Any], shapes: Mapping[str, tuple[int, ...]]
) -> None:
    wanted = " and ".join(f"{name} {shape}" for name, shape in shapes.items())
    expected = f"a {kind.__name__} with numpy arrays of float64: {wanted}"
    if not isinstance(found, kind):
        _refuse(role, part, _in_words(found), expected)
    for name, shape in shapes.items():
        values = getattr(found, name)
        right = isinstance(values, np.ndarray) and values.shape == shape and values.dtype == np.float64
        if not right:
            _refuse(role, part, f"a {kind.__name__} whose {name} is {_in_words(values)}", expected)


def _in_words(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape} and type {value.dtype}"
    return "None" if value is None else f"of type {type(value).__name__}: {value!r:.60}"


def _refuse(role: str, part: object, found: str, expected: str) -> None:
    raise UsageError(f"{role} {type(part).__name__}: update() returned {found}", expected=expected)
