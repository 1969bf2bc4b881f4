"""The robot as it is on paper: geometry, masses and forces of the wall robot (`[robot]` of the bench file).

Nominal data only. Results of a calibration are in `calibration.toml`, true parameters of the emulated robot
in `hil.fakes.plant`; the bench turns the nominal wheels into a `hil.robot.kinematics.WheelGeometry`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, ClassVar

import numpy as np
from pydantic import ValidationInfo, field_validator, model_validator

from hil.config.assumed_parameters import Parameter, each, plus, times
from hil.config.environment import LEAST_FRICTION
from hil.config.field_types import RECORDED, Strict, Within
from hil.core.geometry import Array
from hil.robot.statics import GRAVITY_M_S2, Statics

Place = Annotated[float, Within(-5.0, 5.0, "m from the body's origin")]
Radius = Annotated[float, Within(0.001, 0.5, "m, for example 0.0254")]
Length = Annotated[float, Within(0.001, 10.0, "m")]
Height = Annotated[float, Within(0.0, 1.0, "m above the surface")]
Wheels = tuple[Place, Place, Place, Place]


class RobotConfig(Strict):
    """Nominal robot; body frame x forward, y left, wheels FL, BL, BR, FR; figures of arXiv 2509.04016.

    Attributes:
        name: name of this very robot; its record is refused to others. Left out, the bench's name.
        wheel_x_m, wheel_y_m, wheel_radius_m: contact points in the body, and radii.
        mass_kg: mass with payload.
        centre_of_mass_m: x, y in the body, height above the surface.
        yaw_inertia_kg_m2: moment of inertia about the centre of mass (assumed).
        outline_m: length along x and width along y.
        edf_force_n: adhesion of the ducted fan, acting at the body's origin towards the surface.
        thrust_compensation: share of the weight along the surface that the propellers carry.
        thrust_imbalance: (right - left) / both, of the propeller thrusts.
        propeller_y_m, propeller_height_m: lateral distance and height of the two propellers.
        creep_ratio: stiffness of its tyres against creeping sideways, as a share of lengthwise; an assumption
            for the wheel model `creep`.
        supply_v: servo supply.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("mass_kg", (times(0.6), times(0.5), times(2.0)), ("servos",)),
        Parameter(
            "wheel_radius_m", (times(2.0), times(0.5), times(1.1), each(1, 1.3, 1, 1)), ("mocap", "tracker")
        ),
        Parameter("wheel_x_m", (times(0.5), each(-1, -1, -1, -1), times(1.2)), ("mocap", "tracker")),
        Parameter("wheel_y_m", (times(0.5), each(-1, -1, -1, -1), times(1.2)), ("mocap", "tracker")),
        Parameter("centre_of_mass_m", (plus(0.0, 0.4), plus(0.0, 0.0, 0.221), plus(0.0, 0.0, -0.049))),
    )

    name: str = ""
    wheel_x_m: Wheels = (0.1125, -0.1125, -0.1125, 0.1125)
    wheel_y_m: Wheels = (0.1125, 0.1125, -0.1125, -0.1125)
    wheel_radius_m: tuple[Radius, Radius, Radius, Radius] = (0.0254, 0.0254, 0.0254, 0.0254)
    mass_kg: Annotated[float, Within(0.1, 100.0, "kg; eight small servos move it")] = 3.25
    centre_of_mass_m: tuple[Place, Place, Height] = (-0.049, -0.0065, 0.079)
    yaw_inertia_kg_m2: Annotated[float, Within(1e-5, 100.0, "kg m^2 about its normal")] = 0.045
    outline_m: tuple[Length, Length] = (0.38, 0.30)
    edf_force_n: Annotated[float, Within(0.0, 1000.0, "N")] = 45.0
    thrust_compensation: Annotated[float, Within(0.0, 1.5, "share of the weight")] = 0.7
    thrust_imbalance: Annotated[float, Within(-1.0, 1.0, "share of the thrust")] = 0.0
    propeller_y_m: Length = 0.19
    propeller_height_m: Height = 0.111
    creep_ratio: Annotated[float, Within(0.01, 10.0, "share")] = 0.7
    supply_v: Annotated[float, Within(9.5, 30.0, "V; Dynamixel servos take no other")] = 11.1

    @property
    def weight_n(self) -> float:
        """Weight of the robot, N."""
        return self.mass_kg * GRAVITY_M_S2

    def hold_limit_rad(self) -> float | None:
        """Largest heading at which the robot holds on a wall of friction 0.45 (melamine, assumed).

        There |m g - T e^(i heading)| = friction * adhesion, T the thrust of the propellers. None for a robot
        that holds at no heading.
        """
        weight = self.weight_n
        thrust, friction = self.thrust_compensation * weight, LEAST_FRICTION * self.edf_force_n
        if thrust <= 0.0:
            return math.pi / 2.0 if friction >= weight else None
        cosine = (weight**2 + thrust**2 - friction**2) / (2.0 * weight * thrust)
        return None if cosine > 1.0 else min(math.acos(max(cosine, -1.0)), math.pi / 2.0)

    def propellers(self, thrust_n: float) -> Iterator[tuple[str, Array, Array]]:
        """Name, place (3,) and force (3,) in the body of both propellers, which give `thrust_n` together."""
        for side, name in ((1.0, "left propeller"), (-1.0, "right propeller")):
            share = 0.5 * (1.0 - side * self.thrust_imbalance)
            place_m = np.array([0.0, side * self.propeller_y_m, self.propeller_height_m])
            yield name, place_m, np.array([share * thrust_n, 0.0, 0.0])

    def statics(self, tilt_rad: float, friction: float = LEAST_FRICTION) -> Statics:
        """Weight, wheels and propellers on a surface of this tilt and friction."""
        return Statics(
            self.wheel_x_m,
            self.wheel_y_m,
            self.mass_kg,
            self.centre_of_mass_m,
            self.propeller_height_m,
            tilt_rad,
            friction,
        )

    def wheel_loads_n(self, tilt_rad: float, heading_rad: float = 0.0, *, adheres: bool = True) -> Array:
        """(4,) normal loads at rest by statics, N; zero for a wheel that would have to pull.

        Args:
            tilt_rad: tilt of the surface: 0 floor, pi/2 wall.
            heading_rad: heading of the robot, from up the surface.
            adheres: True if fan and propellers work, as they do on a wall.
        """
        force_n, thrust_n = 0.0, 0.0
        if adheres:
            force_n, thrust_n = self.edf_force_n, self.thrust_compensation * self.weight_n
        loads = np.array(self.statics(tilt_rad).loads_n(force_n, thrust_n, heading_rad))
        press = force_n + self.weight_n * math.cos(tilt_rad)
        return np.asarray(loads * press / loads.sum() if loads.any() else loads, dtype=np.float64)

    @field_validator("wheel_x_m", "wheel_y_m")
    @classmethod
    def _in_their_order(cls, value: Wheels, info: ValidationInfo) -> Wheels:
        """Wheels in the order FL, BL, BR, FR: mirrored ones turn the other way than the robot."""
        fl, bl, br, fr = value
        mirrored = fl < bl and fr < br if info.field_name == "wheel_x_m" else fl < fr and bl < br
        if info.context != RECORDED and mirrored:
            raise ValueError("mirrored: x points forwards, y to the left; wheels in the order FL, BL, BR, FR")
        return value

    @model_validator(mode="after")
    def _wheels_span_an_area(self) -> RobotConfig:
        points = list(zip(self.wheel_x_m, self.wheel_y_m, strict=True))
        x0, y0 = points[0]
        spans = [abs((xa - x0) * (yb - y0) - (ya - y0) * (xb - x0)) for xa, ya in points for xb, yb in points]
        if max(spans) < 1e-6 or not math.isfinite(max(spans)):
            raise ValueError("the wheels of wheel_x_m, wheel_y_m stand on one line: they carry no robot")
        return self
