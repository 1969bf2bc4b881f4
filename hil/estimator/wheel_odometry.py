"""Odometry as an estimator: wheel displacements integrated on SE(2), no other sensor.

It is the baseline for every filter and the bench's fallback. Displacements are differences of wheel angles
(or rates times the step, by `source`). A wheel missing in one read is left out of the least squares.
"""

import math

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.core.clock import NS_PER_S
from hil.core.geometry import Array, compose, se2_exp
from hil.core.interfaces import Estimator
from hil.core.named_records import Records
from hil.core.signals import Measurements, RobotState, WheelMeasurement
from hil.estimator.initial_state import check_state
from hil.estimator.wheel_friction import contacts, windowed_twist
from hil.robot.kinematics import WheelGeometry, forward_matrix, projection, wheel_vectors
from hil.support.numba_jit import kernel

_LEAST_WHEELS = 2


@kernel
def _windowed(u: Array, window: Array, decay: float, wheels: Records, creeping: bool) -> Array:
    """`windowed_twist` with the wheels as an array (1,), which is faster to pass from Python."""
    return windowed_twist(u, window, decay, wheels[0], creeping)


class OdometryEstimator(Estimator):
    """Dead reckoning from the wheels.

    The covariance contains random slip and the slip parameters of the surface that the filters use. Creep and
    turn per rolled metre are constant along the way, so their share of the standard deviation grows with the
    distance, not with its root. A wrong heading also displaces the position.

    Args:
        config: noise of the wheels, and slip of the surface.
        geometry: wheel parameters.
        surface: `wall` or `floor`.
    """

    def __init__(self, config: EstimatorConfig, geometry: WheelGeometry, surface: str) -> None:
        self._geometry, self._noise = geometry, config.wheels
        slip = config.slip(surface)
        self._slips = np.array([slip.creep, slip.creep_across, slip.yaw_rad_m]) ** 2
        self._slip_s = slip.slip_time_s
        self._slip_m2_s2 = np.array([slip.slip_m_s, slip.slip_across_m_s]) ** 2
        self._model = "exact" if config.wheels.model == "equations" else config.wheels.model
        self._projection = projection(geometry.x_m, geometry.y_m)
        self._contacts = contacts(geometry)
        linear = "paper" if self._model == "paper" else "exact"
        self._arm_m2 = 0.25 * float(np.sum(geometry.x_m**2 + geometry.y_m**2))
        self._forward = forward_matrix(geometry.x_m, geometry.y_m, linear)
        self.reset(RobotState(0, np.zeros(3), np.zeros(3), np.zeros((6, 6))))

    def reset(self, state: RobotState) -> None:
        """Start from a known state."""
        check_state(state)
        self._pose = np.array(state.pose_body_in_wall, dtype=np.float64)
        self._twist = np.array(state.twist_body, dtype=np.float64)
        self._covariance = np.array(state.covariance, dtype=np.float64)
        self._last: WheelMeasurement | None = None
        self._window = np.zeros(8)
        self._slopes, self._slipping = np.zeros((3, 3)), np.zeros(2)
        self._rejected = 0

    def update(self, measurements: Measurements) -> RobotState:
        """Integrate the servo reads in order of their stamps; reads not newer than the last are skipped."""
        for sample in sorted(measurements.wheels, key=lambda w: (w.stamp.t_ns, w.stamp.seq)):
            self._take(sample)
        last_ns = self._last.stamp.t_ns if self._last is not None else measurements.t_ns
        ahead_s = max(0.0, (measurements.t_ns - last_ns) / NS_PER_S)
        covariance = self._covariance.copy()
        covariance[:3, :3] += (self._slopes * self._slips) @ self._slopes.T
        return RobotState(
            measurements.t_ns,
            compose(self._pose, se2_exp(self._twist * ahead_s)),
            self._twist.copy(),
            covariance,
            {"rejected_wheels": float(self._rejected)},
        )

    def _take(self, sample: WheelMeasurement) -> None:
        angles = (sample.wheel_angle_rad, sample.steering_rad)
        if any(np.shape(a) != (4,) for a in angles) or len(sample.valid) != 4:
            self._rejected += 1
            return
        usable = _usable(sample)
        if self._noise.source == "velocity":
            usable = [
                u and math.isfinite(r) for u, r in zip(usable, sample.wheel_rate_rad_s.tolist(), strict=True)
            ]
        if sum(usable) < _LEAST_WHEELS:
            self._rejected += 1
            return
        last = self._last
        if last is None:
            self._last = sample
            return
        dt = (sample.stamp.t_ns - last.stamp.t_ns) / NS_PER_S
        usable = [u and k for u, k in zip(usable, _usable(last), strict=True)]
        if dt <= 0.0 or sum(usable) < _LEAST_WHEELS:
            self._rejected += 1
            self._last = last if dt <= 0.0 else sample
            return
        self._integrate(self._displacement(last, sample, usable, dt), dt)
        self._last = sample

    def _displacement(
        self, last: WheelMeasurement, now: WheelMeasurement, usable: list[bool], dt: float
    ) -> Array:
        turned = now.wheel_angle_rad - last.wheel_angle_rad
        if self._noise.source == "velocity":
            turned = now.wheel_rate_rad_s * dt
        turns = np.round((now.steering_rad - last.steering_rad) / (2.0 * np.pi))
        steered = now.steering_rad - 2.0 * np.pi * turns
        heading = 0.5 * (steered + last.steering_rad) - self._geometry.steering_zero_rad
        u = wheel_vectors(turned * self._geometry.radius_m, heading)
        if all(usable):
            if self._model in ("dry-friction", "creep"):
                decay = math.exp(-dt / self._noise.friction_window_s)
                return _windowed(u, self._window, decay, self._contacts, self._model == "creep")
            return np.asarray(self._forward @ u, dtype=np.float64)
        rows = np.repeat(usable, 2)
        return np.asarray(np.linalg.lstsq(self._projection[rows], u[rows], rcond=None)[0], dtype=np.float64)

    def _integrate(self, motion: Array, dt: float) -> None:
        before = self._pose
        self._pose = compose(before, se2_exp(motion))
        self._twist = motion / dt
        noise, covariance = self._noise, self._covariance
        rolled_m = float(np.hypot(motion[0], motion[1]))
        spread = noise.step_m**2 + noise.per_sqrt_m**2 * rolled_m
        covariance[0, 0] += 0.25 * spread + 2.0 * dt * self._slipping[0]
        covariance[1, 1] += 0.25 * spread + 2.0 * dt * self._slipping[1]
        covariance[2, 2] += 0.25 * spread / self._arm_m2
        share = math.exp(-dt / self._slip_s)
        # Covariance of position and slip velocity, which is an Ornstein-Uhlenbeck process.
        self._slipping = share * self._slipping + (1.0 - share) * self._slip_s * self._slip_m2_s2
        self._lean(self._pose - before, rolled_m)

    def _lean(self, step: Array, rolled_m: float) -> None:
        """Update the pose's derivatives by creep along wall x and y and by turn per metre, after a step.

        Args:
            step: (3,) change of the pose in the wall frame.
            rolled_m: length of the step.
        """
        slopes = self._slopes
        slopes[0, 2] -= step[1] * (slopes[2, 2] + 0.5 * rolled_m)
        slopes[1, 2] += step[0] * (slopes[2, 2] + 0.5 * rolled_m)
        slopes[0, 0] += rolled_m
        slopes[1, 1] += rolled_m
        slopes[2, 2] += rolled_m


def _usable(sample: WheelMeasurement) -> list[bool]:
    """Which wheels are marked valid and have both angles."""
    values = zip(sample.valid, sample.wheel_angle_rad.tolist(), sample.steering_rad.tolist(), strict=True)
    return [bool(ok) and math.isfinite(turned) and math.isfinite(steered) for ok, turned, steered in values]
