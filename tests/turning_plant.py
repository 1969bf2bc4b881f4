"""A robot that does nothing but turn, for the tests of inertial units."""

import math

import numpy as np

from hil.fakes.plant_api import Plant, PlantState


class TurningPlant:
    """Turns at a constant rate about the body origin, on a surface of given tilt."""

    body, steering_rad = Plant.body, Plant.steering_rad

    def __init__(self, tilt_rad=math.pi / 2, theta_rad=0.0, rate_rad_s=0.0):
        self.t_ns, self.tilt_rad, self.theta_rad, self.rate_rad_s = 0, tilt_rad, theta_rad, rate_rad_s
        self.acceleration = np.zeros(2)

    def command(self, joint, command):
        raise AssertionError("an IMU commands nothing")

    def advance(self, t_ns):
        self.theta_rad += self.rate_rad_s * (t_ns - self.t_ns) * 1e-9
        self.t_ns = t_ns

    def joints(self):
        return np.zeros(8), np.zeros(8), np.zeros(8)

    def truth(self):
        return PlantState(
            self.t_ns,
            np.array([0.0, 0.0, self.theta_rad]),
            np.array([0.0, 0.0, self.rate_rad_s]),
            self.acceleration.copy(),
            *(np.zeros(8) for _ in range(3)),
            np.zeros(4),
            np.full(4, 8.0),
            np.zeros((4, 2)),
            self.tilt_rad,
            False,
        )
