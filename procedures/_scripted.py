"""Drives the joints by a script instead of a trajectory, through the same loop, supervisor and sinks.

What a procedure needs that looks at single joints (turn one steering servo, roll one wheel) or that
wants to know exactly what was commanded when. The robot is held before and after.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from hil.bench import Bench
from hil.clock import nanoseconds
from hil.errors import UsageError
from hil.geometry import Array, ArrayLike
from hil.interfaces import Controller
from hil.motion import Motion
from hil.signals import CycleRecord, Reference, RobotState, WheelMeasurement, WheelSetpoint

_COVARIANCE = np.diag([1e-8, 1e-8, 1e-7, 1e-6, 1e-6, 1e-6])

Script = Callable[[float], WheelSetpoint]


@dataclass(frozen=True)
class Stretch:
    """Part of a script: wheel rates that hold, and steering angles reached by a ramp from the ones before.

    Attributes:
        duration_s: how long.
        rate_rad_s: (4,) wheel rates.
        steering_rad: (4,) at its end; None for as before.
        ramp: whether the steering goes there evenly; else at once.
    """

    duration_s: float
    rate_rad_s: ArrayLike = (0.0, 0.0, 0.0, 0.0)
    steering_rad: ArrayLike | None = None
    ramp: bool = True


def play(bench: Bench, stretches: Sequence[Stretch], start_pose: ArrayLike, steering_rad: Array) -> Motion:
    """Enable, run through a script of joint commands, hold.

    Args:
        bench: open.
        stretches: one after the other.
        start_pose: where the robot stands, (3,); the supervisor's limits on heading and distance count.
        steering_rad: (4,) where the steering stands.

    Raises:
        SafetyStop, DeviceError: in each case the robot is held.
    """
    times = np.array([0.0, *accumulate(s.duration_s for s in stretches)])
    angles = [np.asarray(steering_rad, dtype=np.float64)]
    for stretch in stretches:
        given = angles[-1] if stretch.steering_rad is None else stretch.steering_rad
        angles.append(np.asarray(given, dtype=np.float64))

    def script(t_s: float) -> WheelSetpoint:
        k = min(int(np.searchsorted(times, t_s, side="right")) - 1, len(stretches) - 1)
        now, part = stretches[k], 1.0
        if now.ramp:
            part = min(1.0, (t_s - times[k]) / now.duration_s)
        steering = angles[k] + part * (angles[k + 1] - angles[k])
        rate = np.asarray(now.rate_rad_s, dtype=np.float64) if t_s < times[-1] else np.zeros(4)
        return WheelSetpoint(rate, steering)

    return run_script(bench, script, float(times[-1]), start_pose)


def run_script(bench: Bench, script: Script, duration_s: float, start_pose: ArrayLike) -> Motion:
    """Command whatever `script(t)` says for a while; the robot's pose is followed by odometry."""
    if not duration_s > 0.0:
        raise UsageError(f"a script of {duration_s} s", expected="more than 0")
    pose = np.asarray(start_pose, dtype=np.float64)
    bench.rig.actuators().enable()
    brain = bench.make_brain(None, feedback="odometry")
    brain.controller = _Scripted(script)
    brain.reference_at = lambda t_s: Reference(t_s, pose, np.zeros(3), np.zeros(3))
    brain.reset(RobotState(bench.clock.now_ns(), pose, np.zeros(3), _COVARIANCE))
    end_ns = bench.clock.now_ns() + nanoseconds(duration_s)
    records: list[CycleRecord] = []

    def until(record: CycleRecord) -> bool:
        records.append(record)
        return record.start_ns >= end_ns

    bench.make_loop(brain).run(until)
    return Motion(tuple(records))


class _Scripted(Controller):
    """A controller that looks at the time only."""

    def __init__(self, script: Script) -> None:
        self._script = script

    def reset(self) -> None:
        """Nothing is remembered."""

    def update(self, state: RobotState, reference: Reference, wheels: WheelMeasurement) -> WheelSetpoint:
        """What the script says for the reference's time."""
        return self._script(reference.t_s)
