"""The set-points of one joint that an operator moves: ramped, bounded, at rest without a command."""

import numpy as np
import pytest

from hil.controller.jog import JogController, JogLimits
from hil.core.errors import UsageError
from hil.core.external_commands import ExternalCommand, ExternalCommands
from hil.core.signals import Stamp, WheelMeasurement

LIMITS = JogLimits(2.0, 10.0, 0.5, 1.0, 0.01)
START_RAD = [0.1, -0.2, 0.3, 0.0]
WHEELS = WheelMeasurement(Stamp(0, 0, 0), np.zeros(4), np.zeros(4), np.array(START_RAD), (True,) * 4)


def moved(controller, wanted, cycles):
    """Set-points of cycles with the same command; None for no command."""
    none = np.zeros(0)
    command = ExternalCommand(0, None, "joints", ("joint",), none, np.array([wanted or 0.0]), none)
    controller.ask = lambda _: ExternalCommands(() if wanted is None else (command,))
    return [controller.update(None, WHEELS) for _ in range(cycles)]


def test_a_wheel_is_ramped_bounded_and_comes_to_rest():
    controller = JogController("jog:drive_BR", LIMITS)
    found = moved(controller, 9.0, 50)
    rates = np.array([s.wheel_rate_rad_s for s in found])
    assert np.diff(rates[:, 2], prepend=0.0).max() <= 0.1 + 1e-12
    assert rates[-1] == pytest.approx([0.0, 0.0, 2.0, 0.0])
    assert all(s.steering_rad.tolist() == START_RAD for s in found)
    after = moved(controller, None, 30)
    assert after[0].wheel_rate_rad_s[2] == pytest.approx(1.9)
    assert not after[-1].wheel_rate_rad_s.any()


def test_a_steering_axis_turns_to_its_limit_and_stays_without_a_command():
    controller = JogController("jog:steer_BL", LIMITS)
    angles = np.array([s.steering_rad for s in moved(controller, 9.0, 10)])
    assert np.diff(angles[:, 1]) == pytest.approx(0.01)
    assert {s.steering_rad[1] for s in moved(controller, None, 10)} == {angles[-1, 1]}
    far = moved(controller, 9.0, 500)
    assert far[-1].steering_rad == pytest.approx([0.1, 0.5, 0.3, 0.0])
    assert not any(s.wheel_rate_rad_s.any() for s in far)


def test_another_name_is_refused():
    with pytest.raises(UsageError, match="jog of 'FL'"):
        JogController("jog:FL", LIMITS)
