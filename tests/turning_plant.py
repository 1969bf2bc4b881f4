"""A robot that does nothing but turn, for the tests of inertial units."""

import math

import numpy as np
from still_plant import StillPlant


class TurningPlant(StillPlant):
    """Turns at a constant rate about the body origin, on a surface of given tilt."""

    def __init__(self, tilt_rad=math.pi / 2, theta_rad=0.0, rate_rad_s=0.0):
        super().__init__(tilt_rad)
        self.theta_rad, self.rate_rad_s = theta_rad, rate_rad_s
        self.acceleration = np.zeros(2)

    def advance(self, t_ns):
        self.theta_rad += self.rate_rad_s * (t_ns - self.t_ns) * 1e-9
        super().advance(t_ns)

    def moves(self):
        return {
            "pose_body_in_wall": np.array([0.0, 0.0, self.theta_rad]),
            "twist_body": np.array([0.0, 0.0, self.rate_rad_s]),
            "acceleration_body": self.acceleration.copy(),
        }
