"""Control: which law, its gains, the module layer's thresholds, and the limits of motion."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Gain = tuple[float, float, float]
NotNegative = Annotated[float, Field(ge=0)]


class ControlConfig(BaseModel):
    """Which law, its gains, the module layer and its limits; sources in `facts/plant_and_control.md`.

    Attributes:
        law: `nonlinear` (model-based, per wheel) or `optimal` (time-varying LQR).
        gains: k_x, k_y, k_theta of the non-linear law, 1/s.
        dead_zone: pose errors (m, m, rad) that are not corrected: below what wheels of 4096 steps a turn
            resolve, a slow wheel would steer after noise, through the play of its gear.
        integral: whether the optimal law has integral action.
        state_weight, integral_weight, input_weight: LQR weights (diagonal, per axis alike).
        integral_clamp: bound of the integral states, m s and rad s.
        servo_lag_s: servo, reporting and bus lag in the optimal law's model.
        still_speed_m_s: below this a wheel holds its last angle.
        flip_hysteresis_rad: beyond a quarter turn before a module is flipped.
        steering_limit_rad, steering_rate_rad_s: of a steering module.
        wheel_speed_m_s, acceleration_m_s2: largest of any wheel; references and setpoints keep within.
        heading_limit_rad: largest heading of a reference on a wall.
        goal_position_m, goal_heading_rad: within these at the end, the robot is held.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    law: Literal["nonlinear", "optimal"] = "nonlinear"
    gains: Gain = (4.0, 4.0, 3.0)
    dead_zone: tuple[NotNegative, NotNegative, NotNegative] = (1e-4, 1e-4, 5e-4)
    integral: bool = True
    state_weight: float = Field(25.0, gt=0)
    integral_weight: float = Field(20.0, ge=0)
    input_weight: float = Field(1.0, gt=0)
    integral_clamp: float = Field(0.1, gt=0)
    servo_lag_s: float = Field(0.1, gt=0)
    still_speed_m_s: float = Field(0.002, ge=0)
    flip_hysteresis_rad: float = Field(0.1047, ge=0, le=0.11)
    steering_limit_rad: float = Field(2.0944, gt=1.6, le=3.0)
    steering_rate_rad_s: float = Field(5.0, gt=0)
    wheel_speed_m_s: float = Field(0.122, gt=0)
    acceleration_m_s2: float = Field(0.2, gt=0)
    heading_limit_rad: float = Field(0.2618, gt=0)
    goal_position_m: float = Field(0.001, ge=0)
    goal_heading_rad: float = Field(0.002, ge=0)
