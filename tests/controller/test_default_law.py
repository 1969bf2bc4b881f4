"""The default law on the emulated wall: how far from the reference it stays, and that it comes to rest."""

import numpy as np

from hil.bench import open_bench
from hil.robot.trajectories import line


def test_across_the_wall_it_keeps_to_its_line_and_rests_at_the_end():
    """A slip velocity leaves the non-linear law 0.8 mm off its line; integral action takes that out."""
    with open_bench("emulated", seed=1) as bench:
        start = bench.settle(0.3)
        way = line(start, np.add(start, [0.0, 0.45, 0.0]), duration_s=9.0)
        motion = bench.drive(way, start_pose=start, hold_s=1.5)
        bench.devices.actuators().close()
    moving = np.array([not r.reference.done for r in motion.records])
    off = (motion.reference - motion.estimate)[moving, 0]
    assert np.sqrt(np.mean(off**2)) <= 0.45e-3
    rates = np.array([r.setpoint.wheel_rate_rad_s for r in motion.records])
    assert not rates[-100:].any()
