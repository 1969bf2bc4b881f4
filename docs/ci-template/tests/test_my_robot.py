"""What I expect of my robot on the wall."""

import numpy as np
import pytest

from hil.core.errors import DeviceTimeoutError
from hil.procedure.tracking_errors import enable_hold
from hil.robot.trajectories import line

UP = np.array([0.1, 0.0, 0.0])


def up(bench):
    """Ten centimetres up from where the robot stands."""
    start = enable_hold(bench)
    return line(start, start + UP, duration_s=4.0)


@pytest.mark.needs("servos", "mocap")
def test_it_climbs_ten_centimetres(bench):
    """Where it ends is measured by motion capture, not by what it believes itself."""
    motion = bench.drive(up(bench), hold_s=1.0)
    assert np.linalg.norm((motion.mocap[-1] - motion.reference[-1])[:2]) < 0.006


@pytest.mark.needs("servos")
@pytest.mark.fault("imu", "off", at=2.0)
def test_it_holds_itself_when_the_inertial_unit_falls_silent(bench):
    """The run ends with an error that names the device, and nothing slides."""
    with pytest.raises(DeviceTimeoutError, match="imu"):
        bench.drive(up(bench))
    assert bench.look().state == "HELD"


@pytest.mark.real_only
@pytest.mark.needs("servos")
def test_the_firmware_is_the_one_we_released(bench):
    """Skipped on emulated servos, and says so."""
    assert set(bench.devices.servos.identity()["firmware"].split(", ")) == {"46"}
