"""A controller that commands joints by a script instead of tracking a trajectory.

A script is plain data. A recording stores it, and replay computes the same setpoints from it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np

from hil.core.errors import UsageError
from hil.core.geometry import ArrayLike
from hil.core.interfaces import Controller
from hil.core.signals import Reference, RobotState, WheelMeasurement, WheelSetpoint

SCRIPT = "script"


@dataclass(frozen=True)
class Stretch:
    """Part of a script: constant wheel rates, and steering angles reached by a ramp or a step.

    Attributes:
        duration_s: duration.
        rate_rad_s: (4,) wheel rates.
        steering_rad: (4,) steering angles at its end; None to keep the angles before.
        ramp: True if the steering angles change linearly over the duration; else in a step.
    """

    duration_s: float
    rate_rad_s: ArrayLike = (0.0, 0.0, 0.0, 0.0)
    steering_rad: ArrayLike | None = None
    ramp: bool = True


class JointScript:
    """Consecutive stretches; afterwards the wheels are at rest.

    Args:
        stretches: stretches of the script, at least one.
        pose: (3,) pose at the start, used as the reference at all times.
        steering_rad: (4,) steering angles at the start.

    Raises:
        UsageError: the total duration is not above 0.
    """

    def __init__(self, stretches: Sequence[Stretch], pose: ArrayLike, steering_rad: ArrayLike) -> None:
        self._stretches = tuple(stretches)
        self._times = np.array([0.0, *accumulate(s.duration_s for s in stretches)])
        if not self.duration_s > 0.0:
            raise UsageError(f"a script of {self.duration_s} s", expected="more than 0")
        self.pose = np.array(pose, dtype=np.float64)
        self._angles = [np.array(steering_rad, dtype=np.float64)]
        for stretch in stretches:
            given = self._angles[-1] if stretch.steering_rad is None else stretch.steering_rad
            self._angles.append(np.asarray(given, dtype=np.float64))
        self._rates = [np.asarray(s.rate_rad_s, dtype=np.float64) for s in stretches]

    @property
    def duration_s(self) -> float:
        """Total duration of all stretches."""
        return float(self._times[-1])

    def sample(self, t_s: float) -> Reference:
        """Reference at time `t_s`: always the start pose, at rest."""
        return Reference(t_s, self.pose, np.zeros(3), np.zeros(3))

    def setpoint(self, t_s: float) -> WheelSetpoint:
        """Wheel setpoint at time `t_s` since the start."""
        k = min(int(np.searchsorted(self._times, t_s, side="right")) - 1, len(self._stretches) - 1)
        now, part = self._stretches[k], 1.0
        if now.ramp:
            part = min(1.0, (t_s - self._times[k]) / now.duration_s)
        steering = self._angles[k] + part * (self._angles[k + 1] - self._angles[k])
        rate = self._rates[k] if t_s < self._times[-1] else np.zeros(4)
        return WheelSetpoint(rate, steering)

    def to_mapping(self) -> dict[str, Any]:
        """Plain data from which `from_mapping` restores the same script exactly."""
        stretches = [
            {
                "duration_s": s.duration_s,
                "rate_rad_s": rate.tolist(),
                "steering_rad": angle.tolist(),
                "ramp": s.ramp,
            }
            for s, rate, angle in zip(self._stretches, self._rates, self._angles[1:], strict=True)
        ]
        return {
            "name": SCRIPT,
            "stretches": stretches,
            "pose": self.pose.tolist(),
            "steering_rad": self._angles[0].tolist(),
        }

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any]) -> JointScript:
        """Script from the data of `to_mapping`; raises `UsageError` for anything else."""
        try:
            stretches = [Stretch(**stretch) for stretch in data["stretches"]]
            return cls(stretches, data["pose"], data["steering_rad"])
        except (KeyError, TypeError, ValueError) as error:
            raise UsageError(f"this is no script ({error!r})", expected="what to_mapping wrote") from None


class ScriptedController(Controller):
    """A controller that depends on the time only."""

    def __init__(self, script: JointScript) -> None:
        self._script = script

    def reset(self) -> None:
        """Do nothing: there is no state."""

    def update(self, state: RobotState, reference: Reference, wheels: WheelMeasurement) -> WheelSetpoint:
        """Wheel setpoint of the script at the reference's time.

        Args:
            state: estimate; not used.
            reference: reference; only its time is used.
            wheels: measurement; not used.
        """
        return self._script.setpoint(reference.t_s)
