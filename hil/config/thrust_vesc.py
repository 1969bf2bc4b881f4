"""Configuration of propellers on VESC motor controllers (`[thrust]`, `model = "vesc"`)."""

import math
from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from hil.config.adhesion import VESC_ID, VescConfig, VescId
from hil.config.assumed_parameters import Parameter, instead, times
from hil.config.can_bus import Claim
from hil.config.can_motor import HIGHEST_DUTY, DaemonMotorConfig
from hil.config.field_types import PolePairs, Within
from hil.config.thrust import ThrustConfig
from hil.robot.motor_cross_checks import MotorRatings

MOST_CONTROLLERS = 4


class VescThrustConfig(ThrustConfig, DaemonMotorConfig):
    """Propellers on one to four VESCs of one CAN bus, all at the same speed.

    Attributes:
        controller_ids: numbers of the controllers, as set in VESC Tool (App Settings, General).
        own_id: id under which this program asks; no controller may have it.
        pole_pairs: pole pairs of the motors: electrical over mechanical speed.
        full_rpm: speed of the propellers at which all together give `full_force_n`; the force goes with the
            square of the speed.
        rpm_per_v: speed of the motors per volt, unloaded.
    """

    PARAMETERS = (
        *ThrustConfig.PARAMETERS,
        Parameter("full_rpm", (times(2.0), times(0.5)), ("servos",)),
        Parameter("rpm_per_v", (times(2.0), times(0.5)), ("thrust",)),
        Parameter("pole_pairs", (instead(21), instead(14), instead(4)), ("thrust",)),
    )

    model: Literal["vesc"] = "vesc"
    controller_ids: tuple[VescId, ...] = Field((2, 3), min_length=1, max_length=MOST_CONTROLLERS)
    own_id: VescId = 253
    pole_pairs: PolePairs = 7
    full_rpm: Annotated[float, Within(1000.0, 100_000.0, "1/min of a propeller, not electrical")] = 9000.0
    rpm_per_v: Annotated[float, Within(10.0, 20_000.0, "1/min per V, as on the motor")] = 900.0

    @field_validator("controller_ids")
    @classmethod
    def _each_once(cls, ids: tuple[int, ...]) -> tuple[int, ...]:
        if len(set(ids)) < len(ids):
            raise ValueError("each controller once: two of one id would both obey")
        return ids

    def speed_for_rpm(self, force_n: float) -> float:
        """Speed at which all propellers together give a force."""
        return self.full_rpm * math.sqrt(force_n / self.full_force_n)

    def ratings(self) -> MotorRatings:
        """The numbers that turn the propellers' measurements into forces."""
        return MotorRatings(
            "thrust",
            self.full_force_n,
            self.full_rpm,
            self.full_force_n,
            rpm_per_v=self.rpm_per_v,
            pole_pairs=self.pole_pairs,
            force_key="full_force_n",
            speed_key="full_rpm",
        )

    @property
    def push_keys(self) -> tuple[str, ...]:
        """The keys of any propellers, with those that scale their speed."""
        return self.ratings().keys

    def motors(self) -> tuple[VescConfig, ...]:
        """The controllers one by one, as if each had all of the force."""
        return tuple(
            VescConfig(
                interface=self.interface,
                channel=self.channel,
                bitrate=self.bitrate,
                options=self.options,
                controller_id=controller_id,
                own_id=self.own_id,
                pole_pairs=self.pole_pairs,
                timeout_s=self.timeout_s,
                open_timeout_s=self.open_timeout_s,
                rated_force_n=self.full_force_n,
                rated_rpm=self.full_rpm,
                rpm_per_v=self.rpm_per_v,
            )
            for controller_id in self.controller_ids
        )

    def claims(self) -> Iterable[Claim]:
        """The VESC ids of the controllers and of this program."""
        theirs = (Claim("controller_ids", VESC_ID, one) for one in self.controller_ids)
        return (*theirs, Claim("own_id", VESC_ID, self.own_id))

    def daemon_spec(self) -> dict[str, Any]:
        """The specification for any motor; every controller gets the same command."""
        first, *others = self.controller_ids
        return {
            **super().daemon_spec(),
            "device": "thrust",
            "controller_id": first,
            "also": tuple(others),
            "highest": {"duty": HIGHEST_DUTY, "erpm": self.pole_pairs * self.full_rpm},
        }
