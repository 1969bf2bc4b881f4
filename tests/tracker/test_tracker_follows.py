"""Camera, driver and alignment together give back the motion of the body."""

import math

import numpy as np
import pytest

from hil.alignment import Alignment, AlignmentParameters, Mount
from hil.geometry import between, quat_from_rotvec
from hil.signals import Inputs

TILTED = tuple(float(v) for v in quat_from_rotvec([0.05, -0.3, 0.2]))


def aligned(bench, samples):
    config = bench.config
    mount = Mount(config.mount_position_m, config.mount_rotation_wxyz)
    alignment = Alignment(AlignmentParameters(tracker=mount))
    return alignment.measure(Inputs(0, 0, tracker=tuple(samples))).tracker


@pytest.mark.parametrize("tilt_rad", [0.0, 0.7, math.pi / 2, 3.0])
@pytest.mark.parametrize("mount", [(1.0, 0.0, 0.0, 0.0), TILTED])
@pytest.mark.parametrize("twist", [(0.1, 0.0, 0.0), (0.05, 0.02, 0.4), (0.0, 0.0, -0.8)])
def test_the_alignment_gives_back_the_motion_of_the_body(
    tracker_bench, travelling_plant, follow, tilt_rad, mount, twist
):
    plant = travelling_plant(twist=twist, tilt_rad=tilt_rad)
    bench = tracker_bench(plant=plant, config={"mount_rotation_wxyz": mount})
    bench.driver.open()
    measured = aligned(bench, follow(bench, 10.0))
    assert len(measured) > 1990
    start = plant.pose(measured[0].stamp.t_ns)
    for m in measured[::37]:
        np.testing.assert_allclose(m.pose, between(start, plant.pose(m.stamp.t_ns)), atol=1e-6)
