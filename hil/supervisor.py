"""Safety: judges data before they are used and setpoints before they are sent.

Stale, implausible or faulty data are reported as events; a condition under which the robot must not
go on raises `SafetyStop`, which the loop answers with `stop()` (wheels at rest, torque on). Deterministic:
depends on the inputs seen since `reset` and on nothing else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hil.clock import nanoseconds
from hil.errors import SafetyStop
from hil.geometry import Array, wrap
from hil.signals import (
    WHEELS,
    Event,
    Inputs,
    Reference,
    RobotState,
    ServoSample,
    Status,
    WheelSetpoint,
)

_HOLD_SAMPLES = 3
_BLOCKED_S, _BLOCKED_RATE_RAD_S, _BLOCKED_RAD = 0.5, 0.5, 0.05


@dataclass(frozen=True)
class SafetyLimits:
    """Limits of one bench; time-outs in s, angles in rad. `heading_limit_rad` counts on a wall only."""

    servo_stale_s: float = 0.1
    imu_stale_s: float = 0.5
    tracker_stale_s: float = 2.0
    wheel_rate_limit_rad_s: float = 4.9
    steering_limit_rad: float = 2.0944
    heading_limit_rad: float = math.radians(15.0)
    tracking_error_limit_m: float = 0.5
    body_speed_limit_m_s: float = 0.5
    adhesion_limit_m_s2: float = 5.0
    on_wall: bool = True


def _finite(values: Array) -> bool:
    """Whether every value is a number; for a handful, plain floats are quicker than an array's tests."""
    return all(map(math.isfinite, values.tolist()))


class Supervisor:
    """Watches one run."""

    def __init__(self, limits: SafetyLimits, *, watched: tuple[str, ...] = ("servos",)) -> None:
        self.limits = limits
        self._watched = watched
        self._stale_ns = {
            "servos": nanoseconds(limits.servo_stale_s),
            "imu": nanoseconds(limits.imu_stale_s),
            "tracker": nanoseconds(limits.tracker_stale_s),
        }
        self.reset()

    def reset(self) -> None:
        """Forget ages and alarms."""
        self._last_ok_ns: dict[str, int] = {}
        self._alarmed: set[str] = set()
        self._weightless = self._sliding = 0
        self._asked = [0.0] * 4
        self._asked_since_ns: list[int | None] = [None] * 4
        self._asked_at_rad = [0.0] * 4

    def check(self, inputs: Inputs) -> tuple[Event, ...]:
        """Judge one cycle's inputs.

        Raises:
            SafetyStop: `stale_servos`, `hardware_error`, `blocked`, `adhesion` or `sliding`. A silent IMU or
                camera is an event at first: the estimator lives without it for a while and says how sure
                it is; a silence that lasts is their driver's `DeviceTimeoutError`, which stops as well.
        """
        events: list[Event] = []
        good = {
            "servos": any(s.ok for s in inputs.servos),
            "imu": any(s.status is Status.OK for s in inputs.imu),
            "tracker": any(s.status is Status.OK for s in inputs.tracker),
        }
        for name in self._watched:
            if name in good:
                self._age(name, good[name], inputs.t_ns, events)
        for sample in inputs.servos:
            if any(sample.alert):
                raise SafetyStop(
                    "hardware_error",
                    f"servo alert bytes {sample.alert}; reboot the servo after removing the cause",
                )
            self._check_moving(sample, inputs.t_ns)
        self._check_hold(inputs)
        return tuple(events)

    def _check_moving(self, sample: ServoSample, t_ns: int) -> None:
        """A wheel that is asked to turn and reports the same angle is blocked, or its servo is stuck."""
        angles = sample.position_rad.tolist()
        for i in range(4):
            since_ns, angle = self._asked_since_ns[i], angles[i]
            if abs(self._asked[i]) < _BLOCKED_RATE_RAD_S or not math.isfinite(angle):
                self._asked_since_ns[i] = None
            elif since_ns is None or abs(angle - self._asked_at_rad[i]) > _BLOCKED_RAD:
                self._asked_since_ns[i], self._asked_at_rad[i] = t_ns, angle
            elif t_ns - since_ns > nanoseconds(_BLOCKED_S):
                raise SafetyStop(
                    "blocked",
                    f"wheel {WHEELS[i]} is asked for {self._asked[i]:.2f} rad/s and has not turned for "
                    f"{_BLOCKED_S:g} s: blocked, or its servo repeats itself",
                )

    def _check_hold(self, inputs: Inputs) -> None:
        """A robot that has come off is weightless; one that slides is faster than it can drive."""
        for imu in inputs.imu:
            if imu.status is Status.OK:
                force = imu.gravity_m_s2 + imu.linear_acceleration_m_s2
                light = math.hypot(*force.tolist()) < self.limits.adhesion_limit_m_s2
                self._weightless = self._weightless + 1 if light else 0
        for tracker in inputs.tracker:
            if tracker.status is Status.OK:
                fast = math.hypot(*tracker.velocity_m_s.tolist()) > self.limits.body_speed_limit_m_s
                self._sliding = self._sliding + 1 if fast else 0
        if self._weightless >= _HOLD_SAMPLES:
            raise SafetyStop("adhesion", "the accelerometer feels less than the weight: adhesion is lost")
        if self._sliding >= _HOLD_SAMPLES:
            raise SafetyStop(
                "sliding", f"the camera sees more than {self.limits.body_speed_limit_m_s:g} m/s: no hold"
            )

    def _age(self, name: str, good: bool, t_ns: int, events: list[Event]) -> None:
        last_ns = self._last_ok_ns.setdefault(name, t_ns)
        if good:
            self._last_ok_ns[name] = t_ns
            if name in self._alarmed:
                self._alarmed.discard(name)
                events.append(Event(t_ns, "info", name, "answers again"))
            return
        if t_ns - last_ns <= self._stale_ns[name]:
            return
        if name == "servos":
            raise SafetyStop("stale_servos", f"no complete servo read for {(t_ns - last_ns) / 1e9:.3f} s")
        if name not in self._alarmed:
            self._alarmed.add(name)
            events.append(Event(t_ns, "warning", name, f"stale for {(t_ns - last_ns) / 1e9:.3f} s"))

    def guard(self, state: RobotState, reference: Reference | None) -> None:
        """Judge the estimate: raises `SafetyStop` for NaN, too much heading on a wall, or a lost robot."""
        pose = state.pose_body_in_wall
        if not (_finite(pose) and _finite(state.twist_body)):
            raise SafetyStop("not_finite", "the estimated state is not finite")
        if self.limits.on_wall and abs(wrap(float(pose[2]))) > self.limits.heading_limit_rad:
            raise SafetyStop(
                "heading",
                f"heading {math.degrees(pose[2]):.1f} deg exceeds "
                f"{math.degrees(self.limits.heading_limit_rad):.1f} deg: the robot would lose its hold",
            )
        if reference is None:
            return
        if not _finite(reference.pose_in_wall):
            raise SafetyStop("not_finite", "the reference is not finite")
        error_m = math.hypot(*(reference.pose_in_wall[:2] - pose[:2]))
        if error_m > self.limits.tracking_error_limit_m:
            raise SafetyStop("tracking", f"{error_m:.3f} m from the reference")

    def limit(self, setpoint: WheelSetpoint) -> WheelSetpoint:
        """Setpoint within command limits; scaling keeps the centre of rotation.

        Raises:
            SafetyStop: `not_finite` or `steering_limit`.
        """
        rate, steering = setpoint.wheel_rate_rad_s, setpoint.steering_rad
        if not (_finite(rate) and _finite(steering)):
            raise SafetyStop("not_finite", "a setpoint is not finite")
        widest = self.limits.steering_limit_rad + 1e-9
        if any(abs(angle) > widest for angle in steering.tolist()):
            raise SafetyStop(
                "steering_limit", f"steering setpoint {np.degrees(steering).round(1).tolist()} deg"
            )
        peak = max(map(abs, rate.tolist()))
        if peak > self.limits.wheel_rate_limit_rad_s:
            setpoint = WheelSetpoint(rate * (self.limits.wheel_rate_limit_rad_s / peak), steering)
        self._asked = setpoint.wheel_rate_rad_s.tolist()
        return setpoint
