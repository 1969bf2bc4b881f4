"""The nominal robot: geometry that recordings are read with and that a fit starts from."""

import math
from dataclasses import dataclass, field

import numpy as np

from hil.robot.kinematics import WheelGeometry


@dataclass(frozen=True)
class Nominal:
    """A robot before any calibration; by default the CAD model of the 4WIS4WID robot.

    Attributes:
        geometry: wheel positions and radii, with loads and creep ratio as far as they are known.
        steering_limit_rad: largest steering angle to either side, rad.
        source: origin of these figures, for messages and results.
    """

    geometry: WheelGeometry = field(default_factory=WheelGeometry.nominal)
    steering_limit_rad: float = math.radians(120.0)
    source: str = "built-in CAD of the 4WIS4WID robot"

    @property
    def radius_m(self) -> float:
        """Mean wheel radius, m."""
        return float(self.geometry.radius_m.mean())

    def to_json(self) -> dict[str, object]:
        """The geometry as it appears in results: lists in wheel order FL, BL, BR, FR."""
        return {
            "source": self.source,
            "x_w_m": self.geometry.x_m.tolist(),
            "y_w_m": self.geometry.y_m.tolist(),
            "r_m": self.geometry.radius_m.tolist(),
            "steering_limit_rad": self.steering_limit_rad,
            **self.geometry.tyres(),
        }

    def in_words(self) -> str:
        """The geometry in one line, mm."""
        x, y, r = (
            "/".join(f"{1e3 * value:.4g}" for value in values)
            for values in (self.geometry.x_m, self.geometry.y_m, self.geometry.radius_m)
        )
        return f"x {x} mm, y {y} mm, radius {r} mm ({self.source})"


def lever_m(geometry: WheelGeometry) -> float:
    """Root mean square distance of the wheels from the middle of the body, m."""
    return float(np.sqrt(np.mean(geometry.x_m**2 + geometry.y_m**2)))
