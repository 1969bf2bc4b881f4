"""True parameters of the emulated robot: nominal ones with seeded random deviations.

Only the plant may read them, and tests that check how well they were identified.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from hil.config.robot import RobotConfig
from hil.config.servo_models import ServoModel
from hil.core.geometry import Array
from hil.core.signals import SERVOS
from hil.fakes.body_interface import HoldingForces
from hil.fakes.plant.surfaces import Surface
from hil.robot.kinematics import WheelGeometry

_STEERING_SIGMA_RAD = math.radians(1.0)
_VELOCITY_P_V_S_RAD, _VELOCITY_I_V_RAD, _POSITION_P_V_RAD = 0.41, 60.0, 100.0
_TUNED_AT_V = 12.0
"""Recommended voltage of the servos with whose recorded stops the gains were tuned."""


@dataclass(frozen=True)
class ContactParameters:
    """Contact of a tyre with a surface; the creep force is stiffness per load times creepage.

    Attributes:
        friction: coefficient of the cone |F| <= friction N.
        creep_along, creep_across: creep stiffness per normal load.
        softening: share of creep stiffness lost as the cone is approached (eta).
        stiffness_n_m, damping_n_s_m: stiffness and damping of the bristles, equal in both directions.
        rolling_resistance: torque at the axle per load and radius.
    """

    friction: float
    creep_along: float
    creep_across: float
    softening: float = 0.95
    stiffness_n_m: float = 25e3
    damping_n_s_m: float = 30.0
    rolling_resistance: float = 0.01


@dataclass(frozen=True)
class JointParameters:
    """Motor, gear and firmware gains of the eight servos, at the output; drives, then steers.

    Attributes:
        torque_constant_n_m_a, back_emf_v_s_rad, resistance_ohm: constants (8,) of the servo model (ROBOTIS
            e-Manual).
        inertia_kg_m2: (8,) rotor and gear.
        coulomb_n_m, viscous_n_m_s: (8,) gear friction; they reproduce the no-load rows of the data sheet.
        velocity_p_v_s_rad, velocity_i_v_rad: velocity loop, tuned to the recorded stops.
        position_p_v_rad: position loop, volts per angle.
        play_rad: (4,) half the backlash between steering servo and wheel.
    """

    torque_constant_n_m_a: Array
    back_emf_v_s_rad: Array
    resistance_ohm: Array
    inertia_kg_m2: Array
    coulomb_n_m: Array
    viscous_n_m_s: Array
    play_rad: Array
    velocity_p_v_s_rad: float
    velocity_i_v_rad: float
    position_p_v_rad: float


@dataclass(frozen=True)
class TrueParameters:
    """True parameters of one emulated robot on one surface.

    Attributes:
        wheel_x_m, wheel_y_m, wheel_radius_m: contact points in the body, and radii, (4,).
        steering_offset_rad: (4,) wheel heading minus servo angle (without play).
        mass_kg, centre_of_mass_m, yaw_inertia_kg_m2: true values of the keys of `RobotConfig`.
        adhesion_n: force towards the surface, 0 while the fan is off.
        thrust_n: force of both propellers along body x.
        thrust_torque_n_m: torque of their imbalance about the body's origin.
        thrust_lever_m: ratio of that torque to the thrust.
        working_point: true forces of fan and propellers at their nominal set-points on a wall.
        propeller_height_m, supply_v: true values of the keys of `RobotConfig`.
    """

    wheel_x_m: Array
    wheel_y_m: Array
    wheel_radius_m: Array
    steering_offset_rad: Array
    mass_kg: float
    centre_of_mass_m: tuple[float, float, float]
    yaw_inertia_kg_m2: float
    adhesion_n: float
    thrust_n: float
    thrust_torque_n_m: float
    thrust_lever_m: float
    working_point: HoldingForces
    propeller_height_m: float
    supply_v: float
    contact: ContactParameters
    joints: JointParameters

    def geometry(self) -> WheelGeometry:
        """Wheel geometry that a perfect calibration would identify (servo angle minus zero = heading)."""
        return WheelGeometry(self.wheel_x_m, self.wheel_y_m, self.wheel_radius_m, -self.steering_offset_rad)


def nominal_joints(servos: ServoModel) -> JointParameters:
    """Joints with eight servos of one model; gear friction is an assumption, equal for all models.

    The firmware's gains are in duty cycle; in volts they scale with the model's supply voltage.
    """
    motor, volts = servos.motor, servos.recommended_v / _TUNED_AT_V
    return JointParameters(
        torque_constant_n_m_a=np.full(len(SERVOS), motor.torque_constant_n_m_a),
        back_emf_v_s_rad=np.full(len(SERVOS), motor.back_emf_v_s_rad),
        resistance_ohm=np.full(len(SERVOS), motor.resistance_ohm),
        inertia_kg_m2=np.full(len(SERVOS), motor.inertia_kg_m2),
        coulomb_n_m=np.array([0.04] * 4 + [0.03] * 4),
        viscous_n_m_s=np.full(len(SERVOS), 0.023),
        play_rad=np.full(4, math.radians(0.125)),
        velocity_p_v_s_rad=_VELOCITY_P_V_S_RAD * volts,
        velocity_i_v_rad=_VELOCITY_I_V_RAD * volts,
        position_p_v_rad=_POSITION_P_V_RAD * volts,
    )


def nominal_parameters(
    robot: RobotConfig, surface: Surface, tilt_rad: float, gravity_m_s2: float, servos: ServoModel
) -> TrueParameters:
    """True parameters that equal the configuration."""
    thrust_n = robot.thrust_compensation * robot.mass_kg * gravity_m_s2 * math.sin(tilt_rad)
    on = 1.0 if surface.adhesive else 0.0
    return TrueParameters(
        wheel_x_m=np.array(robot.wheel_x_m),
        wheel_y_m=np.array(robot.wheel_y_m),
        wheel_radius_m=np.array(robot.wheel_radius_m),
        steering_offset_rad=np.zeros(4),
        mass_kg=robot.mass_kg,
        centre_of_mass_m=robot.centre_of_mass_m,
        yaw_inertia_kg_m2=robot.yaw_inertia_kg_m2,
        adhesion_n=on * robot.edf_force_n,
        thrust_n=on * thrust_n,
        thrust_torque_n_m=on * thrust_n * robot.thrust_imbalance * robot.propeller_y_m,
        thrust_lever_m=robot.thrust_imbalance * robot.propeller_y_m,
        working_point=HoldingForces(
            robot.edf_force_n, robot.thrust_compensation * robot.mass_kg * gravity_m_s2
        ),
        propeller_height_m=robot.propeller_height_m,
        supply_v=robot.supply_v,
        contact=ContactParameters(surface.friction, surface.creep_along, surface.creep_across),
        joints=nominal_joints(servos),
    )


def _spread(rng: np.random.Generator, share: float) -> float:
    return float(1.0 + rng.uniform(-share, share))


def draw(
    nominal: TrueParameters, propeller_y_m: float, rng: np.random.Generator, geometry_share: float = 1.0
) -> TrueParameters:
    """Draw the true parameters of one robot: nominal values with deviations typical of a workshop.

    Args:
        nominal: true parameters that equal the configuration.
        propeller_y_m: lever arm of the propellers' imbalance.
        rng: random numbers.
        geometry_share: factor on the deviations of wheel positions, radii and steering zeros; with a smaller
            one, the same seed gives the same robot nearer to its nominal geometry.
    """
    x, y, height = nominal.centre_of_mass_m
    thrust_spread = _spread(rng, 0.01)
    thrust_n = nominal.thrust_n * thrust_spread
    imbalance = rng.uniform(-0.005, 0.005)
    steering = np.clip(
        rng.normal(0.0, _STEERING_SIGMA_RAD, 4), -2.5 * _STEERING_SIGMA_RAD, 2.5 * _STEERING_SIGMA_RAD
    )
    return replace(
        nominal,
        wheel_x_m=nominal.wheel_x_m * (1.0 + geometry_share * rng.uniform(-0.015, 0.015, 4)),
        wheel_y_m=nominal.wheel_y_m * (1.0 + geometry_share * rng.uniform(-0.015, 0.015, 4)),
        wheel_radius_m=nominal.wheel_radius_m * (1.0 + geometry_share * rng.uniform(-0.01, 0.01, 4)),
        steering_offset_rad=geometry_share * steering,
        mass_kg=nominal.mass_kg * _spread(rng, 0.005),
        centre_of_mass_m=(x + rng.uniform(-2e-3, 2e-3), y + rng.uniform(-1e-3, 1e-3), height),
        yaw_inertia_kg_m2=nominal.yaw_inertia_kg_m2 * _spread(rng, 0.1),
        adhesion_n=nominal.adhesion_n * (fan_spread := _spread(rng, 0.02)),
        thrust_n=thrust_n,
        thrust_torque_n_m=nominal.thrust_torque_n_m + thrust_n * imbalance * propeller_y_m,
        thrust_lever_m=nominal.thrust_lever_m + imbalance * propeller_y_m,
        working_point=HoldingForces(
            nominal.working_point.adhesion_n * fan_spread,
            nominal.working_point.thrust_n * thrust_spread,
            fan_spread,
            thrust_spread,
        ),
        supply_v=nominal.supply_v * _spread(rng, 0.01),
        contact=replace(
            nominal.contact,
            friction=nominal.contact.friction * _spread(rng, 0.03),
            creep_along=nominal.contact.creep_along * _spread(rng, 0.05),
            creep_across=nominal.contact.creep_across * _spread(rng, 0.05),
        ),
        joints=replace(
            nominal.joints,
            torque_constant_n_m_a=nominal.joints.torque_constant_n_m_a * rng.uniform(0.99, 1.01, 8),
            coulomb_n_m=nominal.joints.coulomb_n_m * rng.uniform(0.8, 1.2, 8),
            play_rad=nominal.joints.play_rad * rng.uniform(0.8, 1.2, 4),
        ),
    )
