"""A line up the wall, driven by another program; motion capture says where it ends."""

import numpy as np

from hil.procedure import Context, Measurement, procedure
from hil.procedure.tracking_errors import enable_hold
from hil.robot.trajectories import line

UP = np.array([0.2, 0.0, 0.0])


@procedure(
    name="wall_line",
    needs=("servos", "imu", "tracker", "mocap"),
    measurements=[Measurement("end_error", "mm", high=10.0, rationale="a twentieth of the way")],
)
def run(ctx: Context) -> None:
    """Drive 20 cm up and measure where the robot really ends."""
    start = enable_hold(ctx.bench)
    goal = start + UP
    with ctx.step("drive"):
        motion = ctx.bench.drive(line(start, goal, duration_s=6.0), hold_s=2.0)
    ctx.measure("end_error", 1e3 * np.hypot(*(motion.mocap[-1] - goal)[:2]))
