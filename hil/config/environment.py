"""The surface under the robot, its tilt, and the robot's start pose on it (`[environment]`)."""

import math
from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator

from hil.config.assumed_parameters import Parameter, instead
from hil.config.field_types import Angle, Strict, Within

FLOOR_TILT_RAD = 0.1
"""A steeper surface counts as a wall, with its guards: a robot whose wheels lose their grip slides there."""

FRICTION = {"floor": 0.8, "concrete": 0.8, "melamine": 0.45, "patchy": 0.36}
"""Assumed friction of tyres on surfaces that have a name; on `patchy` that of the worst patch."""
LEAST_FRICTION = 0.45
"""Friction assumed on an unknown surface."""
SURFACES = tuple(FRICTION)
"""Surfaces that can be emulated; a real robot may stand on anything."""

Metres = Annotated[float, Within(-100.0, 100.0, "m in the wall frame")]
Range = tuple[Metres, Metres]


class EnvironmentConfig(Strict):
    """Surroundings of the robot; real and emulated alike.

    Attributes:
        surface: name of the surface. An emulated robot stands on `floor` (needs no adhesion, and lies flat),
            `concrete`, `melamine` or `patchy`; what else a real one stands on is only written down.
        tilt_rad: tilt of the surface: 0 for a floor, pi/2 for a wall, more overhangs. Above 0.1 it counts as
            a wall: gravity lies in the plane of motion, and the wall's guards are on.
        friction: coefficient of tyre on surface, where it is known (`hil run surface_identification` and
            `adhesion_check` find it): the adhesion that is needed depends on it. Left out, an assumption.
        start_pose: (x m, y m, theta rad) in the wall frame: where an emulated robot is when its world begins.
            Where a real one stands is measured by motion capture, else given with `--start`, else this if it
            is written in the file.
        x_range_m, y_range_m: the usable area in the wall frame; a start pose outside it is refused, and
            so are references that leave it. Without them there is no bound.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("tilt_rad", (instead(0.0), instead(1.0), instead(math.pi)), ("imu", "tracker")),
        Parameter("surface"),
        Parameter("friction"),
    )

    surface: str = Field("melamine", min_length=1)
    tilt_rad: Annotated[float, Within(0.0, 3.1416, "0 floor, pi/2 wall, pi ceiling")] = math.pi / 2.0
    friction: Annotated[float, Within(0.05, 2.0, "rubber on anything")] | None = None
    start_pose: tuple[Metres, Metres, Angle] = (0.0, 0.0, 0.0)
    x_range_m: Range | None = None
    y_range_m: Range | None = None

    @field_validator("x_range_m", "y_range_m")
    @classmethod
    def _ordered(cls, value: Range | None) -> Range | None:
        if value is not None and not value[0] < value[1]:
            raise ValueError(f"the surface ends at {value[1]:g} m before it begins at {value[0]:g} m")
        return value

    @property
    def known_friction(self) -> float:
        """`friction`, or what is assumed of a surface of this name."""
        return FRICTION.get(self.surface, LEAST_FRICTION) if self.friction is None else self.friction

    @property
    def on_wall(self) -> bool:
        """Whether gravity lies in the plane of motion and a robot can fall."""
        return self.tilt_rad > FLOOR_TILT_RAD

    @property
    def kind(self) -> Literal["wall", "floor"]:
        """`wall` or `floor`, by `on_wall`."""
        return "wall" if self.on_wall else "floor"
