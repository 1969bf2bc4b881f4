"""Controller of the loop: control law, module layer, goal tolerance, and a stop at values not finite."""

import math

import numpy as np

from hil.config.control import ControlConfig
from hil.controller.laws import Law, NonlinearLaw, OptimalLaw, outside_dead_zone, pose_error
from hil.controller.module_layer import ModuleLayer, ModuleLimits
from hil.core.errors import SafetyStop
from hil.core.geometry import ArrayLike
from hil.core.interfaces import Controller
from hil.core.signals import Reference, RobotState, WheelMeasurement, WheelSetpoint
from hil.robot.kinematics import WheelGeometry
from hil.robot.trajectories import Trajectory


class TrackingController(Controller):
    """Follows a reference; within the goal tolerance it stops the wheels and holds their angles.

    Small corrections at the goal would steer the modules against each other.

    Args:
        law: control law: computes the body twist from the error.
        modules: module layer: computes wheel setpoints from the twist.
        dead_zone: (3,) errors that count as zero, m, m, rad.
        goal_position_m, goal_heading_rad: errors within which the goal is reached.
    """

    def __init__(
        self,
        law: Law,
        modules: ModuleLayer,
        *,
        dead_zone: ArrayLike,
        goal_position_m: float,
        goal_heading_rad: float,
    ) -> None:
        self._law, self._modules = law, modules
        ahead, left, turn = np.array(dead_zone, dtype=np.float64).tolist()
        self._dead_zone = (ahead, left, turn)
        self._goal_position_m, self._goal_heading_rad = goal_position_m, goal_heading_rad

    def reset(self) -> None:
        """Reset the law's integrators and the held angles."""
        self._law.reset()
        self._modules.reset()

    def update(self, state: RobotState, reference: Reference, wheels: WheelMeasurement) -> WheelSetpoint:
        """Wheel setpoint for this cycle.

        Args:
            state: estimate, pose in the wall frame.
            reference: pose in the wall frame, and twist.
            wheels: newest wheel measurement, aligned in time.

        Raises:
            SafetyStop: `not_finite` when state, reference or the law's output is not finite.
        """
        error = pose_error(state, reference)
        outside = outside_dead_zone(error, self._dead_zone)
        twist = self._law.twist(outside, reference)
        if not math.isfinite(sum(error) + sum(twist.tolist())):  # NaN and inf carry over to the sum
            raise SafetyStop("not_finite", "state, reference or gains are not finite")
        at_goal = (
            reference.done
            and np.hypot(error[0], error[1]) <= self._goal_position_m
            and abs(error[2]) <= self._goal_heading_rad
        )
        if at_goal:
            return self._modules.hold(wheels.steering_rad)
        setpoint = self._modules.allocate(twist, wheels.steering_rad)
        if self._modules.following:
            self._law.learn(outside)
        return setpoint


def make_modules(config: ControlConfig, geometry: WheelGeometry, *, rate_hz: float) -> ModuleLayer:
    """Module layer with the limits of a configuration.

    Args:
        config: `[control]` of the bench file.
        geometry: wheel parameters.
        rate_hz: rate of the loop, Hz.
    """
    limits = ModuleLimits(
        config.wheel_speed_m_s,
        config.steering_limit_rad,
        config.steering_rate_rad_s,
        config.still_speed_m_s,
        config.flip_hysteresis_rad,
        config.contradiction_m_s,
    )
    return ModuleLayer(geometry, limits, 1.0 / rate_hz)


def make_controller(
    config: ControlConfig, geometry: WheelGeometry, trajectory: Trajectory, *, rate_hz: float = 100.0
) -> TrackingController:
    """Tracking controller for one trajectory; computes the gains of the optimal law.

    Args:
        config: `[control]` of the bench file.
        geometry: wheel parameters.
        trajectory: trajectory to follow.
        rate_hz: rate of the loop, Hz.
    """
    dt_s = 1.0 / rate_hz
    law: Law = NonlinearLaw(config.gains)
    if config.law == "optimal":
        law = OptimalLaw(
            lambda t_s: float(trajectory.sample(t_s).twist_body[2]),
            trajectory.duration_s,
            dt_s=dt_s,
            lag_s=config.servo_lag_s,
            weights=(
                config.state_weight,
                config.integral_weight if config.integral else 0.0,
                config.input_weight,
            ),
            clamp=config.integral_clamp,
        )
    return TrackingController(
        law,
        make_modules(config, geometry, rate_hz=rate_hz),
        dead_zone=config.dead_zone,
        goal_position_m=config.goal_position_m,
        goal_heading_rad=config.goal_heading_rad,
    )
