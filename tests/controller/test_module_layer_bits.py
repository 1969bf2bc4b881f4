"""The module layer beside the same in arrays: not a bit may differ."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.controller.allocation import ModuleLayer, ModuleLimits, optimize
from hil.robot.kinematics import WheelGeometry, inverse, wheel_vectors
from hil.vocabulary.geometry import wrap_array

CAD = WheelGeometry.nominal()
DT = 0.01


def scaled(values, peak, limit):
    return values if peak <= limit else values * (limit / peak)


class ArrayLayer:
    """The module layer by numpy's arrays throughout."""

    def __init__(self, geometry, limits, dt_s):
        self.geometry, self.limits, self.dt_s, self.held, self.sent = geometry, limits, dt_s, None, None
        p = geometry.projection()
        self.contradicting = np.eye(8) - p @ np.linalg.pinv(p)

    def allocate(self, twist, measured):
        g, limits = self.geometry, self.limits
        goals = (measured if self.held is None else self.held).tolist()
        speeds, angles = (values.tolist() for values in inverse(g, twist))
        for i in range(4):
            if speeds[i] < limits.still_speed_m_s:
                speeds[i] = 0.0
            else:
                speeds[i], goals[i] = optimize(speeds[i], angles[i], float(measured[i]), limits)
        target = self.held = np.array(goals)
        towards = np.maximum(0.0, np.cos(wrap_array(target - measured)))
        speed = np.array(speeds) * towards
        speed = scaled(speed, np.abs(speed).max(), limits.speed_m_s)
        sent = measured if self.sent is None else self.sent
        step, reach = target - sent, limits.steering_rate_rad_s * self.dt_s
        self.sent = sent + scaled(step, np.abs(step).max(), reach)
        bounded = np.clip(self.sent, -limits.steering_rad, limits.steering_rad)
        u = wheel_vectors(speed, np.stack([measured, bounded]) - g.steering_zero_rad)
        left = u @ self.contradicting
        speed = scaled(speed, np.hypot(left[:, 0::2], left[:, 1::2]).max(), limits.contradiction_m_s)
        return speed / g.radius_m, bounded

    def hold(self):
        self.sent = self.held
        return self.held


@given(st.integers(0, 10_000))
@settings(max_examples=40)
def test_the_module_layer_gives_the_bits_of_arrays(seed):
    """So that what was recorded can be repeated: a run by arrays and one by the layer do not differ."""
    rng = np.random.default_rng(seed)
    geometry = CAD.with_vector(np.concatenate([CAD.vector()[:12], rng.uniform(-0.05, 0.05, 4)]))
    mine, theirs = (layer(geometry, ModuleLimits(), DT) for layer in (ModuleLayer, ArrayLayer))
    steering = rng.uniform(-2.0, 2.0, 4)
    for k in range(120):
        if k % 30 == 0:
            twist = np.array([*rng.uniform(-0.15, 0.15, 2), rng.uniform(-0.5, 0.5)]) * rng.integers(0, 2)
        out = mine.allocate(twist, steering)
        rates, angles = theirs.allocate(twist, steering)
        assert np.array_equal(out.wheel_rate_rad_s, rates)
        assert np.array_equal(out.steering_rad, angles)
        steering = steering + rng.uniform(0.2, 0.8) * (out.steering_rad - steering)
        if k % 30 == 20 and rng.integers(0, 2):
            assert np.array_equal(mine.hold(steering).steering_rad, theirs.hold())
