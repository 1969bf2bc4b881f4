"""Control: which law, its gains, the module layer's thresholds, and the limits of motion."""

from typing import Annotated

from hil.config.field_types import HeadingLimit, Strict, Switch, WheelRate, Within
from hil.core.known_names import LawName

Gain = Annotated[
    float, Within(0.01, 100.0, "1/s; 0 corrects nothing, beyond 100 a loop of 100 Hz overshoots")
]
DeadZone = Annotated[float, Within(0.0, 0.05, "a robot that far off (m, rad) has to be corrected")]
Weight = Annotated[float, Within(1e-6, 1e6, "only the ratios of the weights count")]

_OF_LAW: dict[str, LawName] = {
    "gains": "nonlinear",
    "integral": "optimal",
    "state_weight": "optimal",
    "integral_weight": "optimal",
    "input_weight": "optimal",
    "integral_clamp": "optimal",
    "servo_lag_s": "optimal",
}
"""Keys that only one law reads."""


def law_of(key: str) -> LawName | None:
    """The one control law that reads a key of the bench file; None for keys that concern every law.

    Args:
        key: key with its table, such as `control.gains`; may begin with `bench.` or `config.`.
    """
    table, _, name = key.removeprefix("bench.").removeprefix("config.").partition(".")
    return _OF_LAW.get(name) if table == "control" else None


class ControlConfig(Strict):
    """Control law, its gains, the module layer and its limits.

    Attributes:
        law: `optimal` (time-varying LQR), or `nonlinear` (the authors', model-based, per wheel), which lags
            behind by what the wheels slip.
        gains: k_x, k_y, k_theta of the non-linear law, 1/s.
        dead_zone: pose errors (m, m, rad) that are not corrected: below what wheels of 4096 steps a turn
            resolve, a slow wheel would steer after noise, through the backlash of its gear.
        integral: true for integral action of the optimal law; it learns only while the wheels can follow.
        state_weight, integral_weight, input_weight: LQR weights (diagonal, per axis alike).
        integral_clamp: bound of the integral states, m s and rad s.
        servo_lag_s: servo, reporting and bus lag in the optimal law's model.
        still_speed_m_s: wheel speed below which a wheel holds its last angle.
        flip_hysteresis_rad: angle beyond a quarter turn before a module is flipped.
        contradiction_m_s: speed at which a wheel may slip because the wheels' angles belong to no common
            centre of rotation, as they do while modules steer: beyond, all four wheels are slowed alike.
        steering_limit_rad, steering_rate_rad_s: largest angle and largest rate of a steering module.
        wheel_speed_m_s, acceleration_m_s2: largest of any wheel; references and setpoints keep within.
        heading_limit_rad: largest heading of a reference on a wall.
        goal_position_m, goal_heading_rad: tolerances within which the robot is held at the end.
    """

    law: LawName = "optimal"
    gains: tuple[Gain, Gain, Gain] = (4.0, 4.0, 3.0)
    dead_zone: tuple[DeadZone, DeadZone, DeadZone] = (1e-4, 1e-4, 5e-4)
    integral: Switch = True
    state_weight: Weight = 25.0
    integral_weight: Annotated[float, Within(0.0, 1e6, "only the ratios of the weights count")] = 20.0
    input_weight: Weight = 1.0
    integral_clamp: Annotated[float, Within(1e-4, 10.0, "m s, rad s; more winds up")] = 0.01
    servo_lag_s: Annotated[float, Within(0.001, 1.0, "a servo follows within a second")] = 0.1
    still_speed_m_s: Annotated[float, Within(0.0, 0.05, "faster than that, a wheel rolls")] = 0.002
    flip_hysteresis_rad: Annotated[
        float, Within(0.0, 0.11, "rad; beyond it a module meets its steering limit")
    ] = 0.1047
    contradiction_m_s: Annotated[float, Within(1e-4, 0.5, "wheels are not faster than that")] = 0.004
    steering_limit_rad: Annotated[
        float, Within(1.61, 3.0, "rad; less than a quarter turn reaches not every direction")
    ] = 2.0944
    steering_rate_rad_s: WheelRate = 5.0
    wheel_speed_m_s: Annotated[float, Within(0.001, 3.5, "wheels of 0.5 m at 7 rad/s")] = 0.122
    acceleration_m_s2: Annotated[float, Within(0.001, 6.0, "friction 0.45 of 45 N moves 3.25 kg by 6")] = 0.2
    heading_limit_rad: HeadingLimit = 0.2618
    goal_position_m: Annotated[float, Within(0.0, 0.1, "a goal that far away is not reached")] = 0.001
    goal_heading_rad: Annotated[float, Within(0.0, 0.2, "a goal that far away is not reached")] = 0.002

    def unread(self, law: str) -> str:
        """Sentence on keys that are set and that this law does not read; empty for none."""
        keys = [f"control.{key}" for key in sorted(self.model_fields_set) if _OF_LAW.get(key, law) != law]
        belongs = f"{'belongs' if len(keys) == 1 else 'belong'} to the other control law"
        return f"{', '.join(keys)} {belongs}: the law {law!r} does not read it" if keys else ""
