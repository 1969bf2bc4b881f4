"""A wheel that differs between repetitions, or alone from the other three, is named with what undoes it."""

from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.synthetic import hidden_robot, make_set
from hil.datasets.changed_wheels import changed_wheels, with_changed_wheels
from hil.robot.kinematics import WheelGeometry

CAD = WheelGeometry.nominal()


@pytest.fixture(scope="module", params=["viscous", "coulomb", "elastic"])
def good(request):
    return make_set(
        hidden_robot(4, contact=request.param),
        4,
        ("line_x", "line_y", "circle_ccw", "rotation_cw", "scan"),
        2,
    )


def steered(one, wheel, by_rad):
    return replace(one, steering_rad=one.steering_rad + by_rad * np.eye(4)[wheel])


def rolled(one, wheel, factor):
    return replace(one, wheel_angle_rad=one.wheel_angle_rad * (1.0 + (factor - 1.0) * np.eye(4)[wheel]))


def test_tolerances_noise_and_slip_change_no_wheel(good):
    assert with_changed_wheels(good, CAD) == good


@pytest.mark.parametrize(
    ("change", "wheel", "said"),
    [
        (lambda one: steered(one, 2, 0.1), "BR", "{} (it would agree if delta3 were -0.1"),
        (lambda one: rolled(one, 1, 1.25), "BL", "{} (it would agree if phi2 grew 0.80 times as much)"),
    ],
    ids=["steering", "scale"],
)
@pytest.mark.parametrize("number", [0, 5])
def test_a_wheel_that_changes_between_repetitions_is_named_with_the_recording(
    good, number, change, wheel, said
):
    (line,) = changed_wheels([change(one) if k == number else one for k, one in enumerate(good)], CAD)
    assert line.startswith(f"the {wheel} wheel")
    assert said.format(good[number].name) in line


def test_a_zero_that_moved_between_two_sessions_is_named(good):
    (line,) = changed_wheels([steered(one, 0, 0.1) if k % 2 else one for k, one in enumerate(good)], CAD)
    assert line.startswith("the FL wheel")
    assert line.count("delta1") == 5


def test_a_wheel_that_is_wrong_everywhere_is_named(good):
    (line,) = changed_wheels([steered(one, 3, 0.3) for one in good], CAD)
    assert line.startswith("the FR wheel (phi4, delta4) alone")
    assert "delta4 were -0.3" in line or "delta4 were -0.2" in line
