"""Slip per metre that is known by direction: the filter reckons with it, whatever the heading."""

import math

import numpy as np
import pytest
from test_camera_scale import CREEP, MATCHED, climb, followed

from hil.config.estimator import EstimatorConfig
from hil.estimator.kernel_layout import first_memory, parameters
from hil.estimator.sensors import wheels
from hil.robot.kinematics import WheelGeometry
from hil.support.numba_jit import kernel

known_slip = kernel(wheels.known_slip)

KNOWN = {
    "known_up": (-0.034, 0.001, 0.01),
    "known_down": (-0.036, -0.001, 0.02),
    "known_left": (-0.05, 0.002, 0.03),
    "known_right": (-0.052, -0.002, 0.04),
}


def slip_in_wall(direction_rad, heading_rad):
    """Known slip per metre, wall axes, of a body that drives in a direction of the wall under a heading."""
    par = parameters(EstimatorConfig(wall=KNOWN), WheelGeometry.nominal(), "wall")[0].wheels
    memory = first_memory()[0].wheels
    memory.heading_rad = heading_rad
    alpha = direction_rad - heading_rad
    memory.mean[:] = 0.08 * math.cos(alpha), 0.08 * math.sin(alpha), 0.0
    x, y, turn = known_slip(memory, par, 0.5) / 0.04
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    return np.array([c * x - s * y, s * x + c * y, turn])


@pytest.mark.parametrize("heading_rad", [0.0, 0.2, -1.0])
def test_each_direction_has_its_own_slip_whatever_the_heading(heading_rad):
    for name, direction in (("up", 0.0), ("left", 0.5), ("down", 1.0), ("right", -0.5)):
        assert slip_in_wall(direction * math.pi, heading_rad) == pytest.approx(
            KNOWN[f"known_{name}"], abs=1e-12
        )


def test_between_the_axes_it_is_that_of_tyres_stiffer_along_than_across():
    """A pull downhill on wheels at an angle: each of its two parts gives way by its own stiffness."""
    along, across = 0.035, 0.051
    plain = {
        "known_up": (-along, 0, 0),
        "known_down": (-along, 0, 0),
        "known_left": (-across, 0, 0),
        "known_right": (-across, 0, 0),
    }
    par = parameters(EstimatorConfig(wall=plain), WheelGeometry.nominal(), "wall")[0].wheels
    memory = first_memory()[0].wheels
    for angle in (0.3, 0.9, 2.0, -2.5):
        c, s = math.cos(angle), math.sin(angle)
        memory.mean[:] = c, s, 0.0
        want = (
            np.array([[c, -s], [s, c]]) @ np.diag([along, across]) @ np.array([[c, s], [-s, c]]) @ [-1.0, 0.0]
        )
        assert known_slip(memory, par, 1.0)[:2] == pytest.approx(want, abs=1e-12)


def test_at_rest_there_is_none():
    par = parameters(EstimatorConfig(wall=KNOWN), WheelGeometry.nominal(), "wall")[0].wheels
    assert known_slip(first_memory()[0].wheels, par, 0.5).tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_known_slip_reports_the_cameras_scale_on_a_climb(kind):
    """Nothing else does on a vertical line: with slip unknown the camera's 1 % stays in the estimate."""
    ends = {}
    for name, wall in (
        ("unknown", {}),
        ("known", {"known_up": (-CREEP, 0.0, 0.0), "creep": 0.001, "creep_per_sqrt_m": 0.0005}),
    ):
        parts, start, path = climb(0.01, 1)
        states = followed(
            EstimatorConfig(kind=kind, tracker=MATCHED, wall={"slip_m_s": 1e-4, **wall}), parts, start
        )
        ends[name] = 1e3 * (states[-1].pose_body_in_wall[0] - path.pose[-1, 0])
    assert abs(ends["unknown"]) > 6.0
    assert abs(ends["known"]) < 3.0
