"""A body that travels as a test says, for the tests of what measures its poses."""

import math

import numpy as np
from still_plant import StillPlant


class TravellingPlant(StillPlant):
    """Drives a circle (or a line) with a constant body twist from a given pose."""

    def __init__(self, twist=(0.05, 0.02, 0.1), start=(0.3, -0.2, 0.5), tilt_rad=math.pi / 2):
        super().__init__(tilt_rad)
        self.start, self.twist = np.array(start, float), np.array(twist, float)

    def pose(self, t_ns):
        vx, vy, w = self.twist
        x, y, th = self.start
        t = t_ns * 1e-9
        a = w * t
        sin, cos = (t, 0.0) if w == 0 else (math.sin(a) / w, (1 - math.cos(a)) / w)
        dx, dy = vx * sin - vy * cos, vy * sin + vx * cos
        c, s = math.cos(th), math.sin(th)
        return np.array([x + c * dx - s * dy, y + s * dx + c * dy, th + a])

    def moves(self):
        return {"pose_body_in_wall": self.pose(self.t_ns), "twist_body": self.twist.copy()}
