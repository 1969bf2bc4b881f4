"""Configuration of the fan that presses the robot on its wall (`[adhesion]` of the bench file)."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal

from hil.config.assumed_parameters import Parameter, instead, times
from hil.config.can_bus import Claim
from hil.config.can_motor import HIGHEST_DUTY, DaemonMotorConfig
from hil.config.device import DeviceConfig
from hil.config.field_types import PolePairs, Switch, Within
from hil.robot.motor_cross_checks import DROOP, MotorRatings, force_of_speed

VESC_ID = "VESC id"
VescId = Annotated[int, Within(0, 254, "255 addresses all")]
Force = Annotated[float, Within(1.0, 500.0, "N: more than a fan of this size gives, or less than any need")]


class AdhesionConfig(DeviceConfig):
    """A fan with any controller: the keys that bench, checks and procedures need.

    Attributes:
        force_n: set-point on a wall; `robot.edf_force_n` when left out.
        highest_force_n: largest set-point.
        by_need: true for a force that follows posture, surface and tilt instead of `force_n` while the robot
            is driven: a tenth more than the limit at which it would be stopped.
        rated_force_n, rated_rpm: force at a speed; it goes with the square of the speed. `hil run
            adhesion_check` finds it.
        rated_input_a, rated_input_v: current from the battery at that speed, and its voltage then.
        low_input_v: battery voltage under load below which the robot is stopped: 3.3 V per cell of a 6S pack.
        hot_fet_c: temperature of the power stage above which it is stopped: before a VESC slows the fan down,
            at 85 degC as delivered.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("rated_force_n", (times(2.0), times(0.5), times(1.3)), ("load_cells",)),
        Parameter("rated_rpm", (times(2.0), times(0.5), times(1.2)), ("load_cells",)),
    )

    force_n: Force | None = None
    highest_force_n: Force = 60.0
    by_need: Switch = False
    rated_force_n: Force = 45.0
    rated_rpm: Annotated[float, Within(1000.0, 200_000.0, "1/min of the fan, not electrical")] = 30_000.0
    rated_input_a: Annotated[float, Within(0.5, 300.0, "A from the battery")] = 30.0
    rated_input_v: Annotated[float, Within(3.0, 100.0, "V of the battery under load")] = 22.8
    low_input_v: Annotated[float, Within(0.0, 100.0, "V of the battery")] = 20.0
    hot_fet_c: Annotated[float, Within(30.0, 150.0, "degC")] = 80.0

    def ratings(self) -> MotorRatings:
        """The numbers that turn the fan's measurements into forces."""
        watts = self.rated_input_a * self.rated_input_v
        return MotorRatings(
            "adhesion", self.rated_force_n, self.rated_rpm, self.highest_force_n, rated_w=watts
        )

    def force_at_n(self, speed_rpm: float) -> float:
        """Force of the fan at a speed, N; below 0 for a fan that turns backwards."""
        return force_of_speed(self.rated_force_n, self.rated_rpm, speed_rpm)

    def speed_for_rpm(self, force_n: float) -> float:
        """Speed of the fan for a force, 1/min."""
        return self.rated_rpm * math.sqrt(force_n / self.rated_force_n)


class MotorConfig(AdhesionConfig, DaemonMotorConfig):
    """A fan whose motor controller is on CAN.

    Attributes:
        command: quantity that the controller is given: `duty`, `current` or `rpm`.
        rpm_per_v: speed of the motor per volt, unloaded.
    """

    PARAMETERS = (
        *AdhesionConfig.PARAMETERS,
        Parameter("rpm_per_v", (times(2.0), times(0.5), times(1.3)), ("adhesion",)),
    )

    command: Literal["duty", "current", "rpm"] = "duty"
    rpm_per_v: Annotated[float, Within(10.0, 20_000.0, "1/min per V, as on the motor")] = 1750.0

    def ratings(self) -> MotorRatings:
        """Ratings of any fan, with the law of its motor."""
        known = super().ratings()
        motor_a = known.rated_w * DROOP * self.rpm_per_v / self.rated_rpm
        return replace(known, rpm_per_v=self.rpm_per_v, rated_motor_a=motor_a)

    @property
    def counts_per_turn(self) -> int:
        """Speed in the controller's counts for 1/min of the fan."""
        return 1

    def daemon_spec(self) -> dict[str, Any]:
        """The arguments of its daemon's `Spec`, with the highest set-points of a fan."""
        fastest_rpm = self.speed_for_rpm(self.highest_force_n)
        highest = {
            "duty": HIGHEST_DUTY,
            "current_a": 4.0 * self.rated_input_a,
            "erpm": self.counts_per_turn * fastest_rpm,
        }
        return {**super().daemon_spec(), "highest": highest}


class VescConfig(MotorConfig):
    """A VESC motor controller with its own protocol.

    Attributes:
        controller_id: number of the controller, as set in VESC Tool (App Settings, General).
        own_id: id of this program in its requests; no controller may have it.
        pole_pairs: pole pairs of the motor: its electrical over its mechanical speed.
    """

    PARAMETERS = (
        *MotorConfig.PARAMETERS,
        Parameter("pole_pairs", (instead(7), instead(4), instead(2), instead(1)), ("adhesion",)),
    )

    model: Literal["vesc"] = "vesc"
    controller_id: VescId = 1
    own_id: VescId = 254
    pole_pairs: PolePairs = 3

    def ratings(self) -> MotorRatings:
        """Ratings of any motor, with its pole pairs."""
        return replace(super().ratings(), pole_pairs=self.pole_pairs)

    @property
    def counts_per_turn(self) -> int:
        """Electrical turns per turn of the fan."""
        return self.pole_pairs

    def claims(self) -> Iterable[Claim]:
        """The ids of the controller and of this program."""
        return (Claim("controller_id", VESC_ID, self.controller_id), Claim("own_id", VESC_ID, self.own_id))

    def daemon_spec(self) -> dict[str, Any]:
        """The arguments of its daemon's `Spec`, with the controller's id."""
        return {**super().daemon_spec(), "controller_id": self.controller_id}
