"""filterpy's own UKF as its documentation uses it, with the paper's settings: what ours is compared with.

Six states (pose, body twist), prediction once per control cycle, then one `update` per sensor, without
drawing the sigma points again; default sums; alpha 0.001, beta 2, kappa 0. Nothing is repaired: where the
covariance is lost, the filter ends and says when.
"""

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from hil.core.signals import RobotState
from hil.robot.kinematics import forward_matrix

Q = np.diag([1e-8, 1e-8, 1e-8, 2e-4, 2e-4, 4e-4])
R_WHEELS = np.diag([0.003, 0.003, 0.02]) ** 2
R_GYRO = np.array([[0.003**2]])
R_CAMERA = np.diag([0.01, 0.01, 0.01]) ** 2


def _move(x, dt):
    c, s = np.cos(x[2]), np.sin(x[2])
    return np.array(
        [x[0] + dt * (c * x[3] - s * x[4]), x[1] + dt * (s * x[3] + c * x[4]), x[2] + dt * x[5], *x[3:]]
    )


class PlainFilterpy:
    """An `Estimator` that ends with `lost_s` set when filterpy raises or the covariance is no covariance."""

    def __init__(self, geometry, alpha=1e-3):
        points = MerweScaledSigmaPoints(6, alpha, 2.0, 0.0)
        self._filter = UnscentedKalmanFilter(6, 3, 0.01, None, _move, points)
        self._forward = forward_matrix(geometry.x_m, geometry.y_m, "paper")
        self._geometry = geometry

    def reset(self, state):
        f = self._filter
        f.x = np.concatenate([state.pose_body_in_wall, state.twist_body])
        f.P, f.Q = state.covariance + 1e-12 * np.eye(6), Q
        self._begin_ns = self._last_ns = state.t_ns
        self._frame = None
        self.lost_s = None

    def update(self, m):
        f = self._filter
        if self.lost_s is None:
            try:
                f.predict(dt=(m.t_ns - self._last_ns) * 1e-9)
                self._measure(m)
            except np.linalg.LinAlgError:
                self.lost_s = (m.t_ns - self._begin_ns) * 1e-9
            if self.lost_s is None and not np.all(np.diag(f.P) > 0.0):
                self.lost_s = (m.t_ns - self._begin_ns) * 1e-9
        self._last_ns = m.t_ns
        return RobotState(m.t_ns, f.x[:3].copy(), f.x[3:].copy(), f.P.copy())

    def _measure(self, m):
        f = self._filter
        for w in m.wheels[-1:]:
            heading = w.steering_rad - self._geometry.steering_zero_rad
            speed = w.wheel_rate_rad_s * self._geometry.radius_m
            u = np.column_stack([speed * np.cos(heading), speed * np.sin(heading)]).ravel()
            f.update(self._forward @ u, R=R_WHEELS, hx=lambda x: x[3:6])
        for g in m.gyro[-1:]:
            f.update(np.array([g.yaw_rate_rad_s]), R=R_GYRO, hx=lambda x: x[5:6])
        for c in m.tracker[-1:]:
            if self._frame is None:
                self._frame = f.x[:3].copy()
            fx, fy, ft = self._frame
            cf, sf = np.cos(ft), np.sin(ft)
            z = np.array(
                [fx + cf * c.pose[0] - sf * c.pose[1], fy + sf * c.pose[0] + cf * c.pose[1], ft + c.pose[2]]
            )
            f.update(z, R=R_CAMERA, hx=lambda x: x[:3])
