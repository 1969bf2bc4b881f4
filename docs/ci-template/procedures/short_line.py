"""A procedure: what it measures and within which limits; `hil run` gives verdict and report."""

import numpy as np

from hil.procedure import Context, Measurement, procedure
from hil.procedure.tracking_errors import enable_hold
from hil.robot.trajectories import line

UP = np.array([0.1, 0.0, 0.0])


@procedure(
    name="short_line",
    needs=("servos", "mocap"),
    measurements=[Measurement("end_error", "mm", high=20.0, rationale="a tenth of the way and a margin")],
)
def run(ctx: Context) -> None:
    """Drive 10 cm up and measure where the robot really ends."""
    start = enable_hold(ctx.bench)
    goal = start + UP
    with ctx.step("drive"):
        motion = ctx.bench.drive(line(start, goal, duration_s=4.0), hold_s=1.0)
    ctx.measure("end_error", 1e3 * abs(motion.mocap[-1, 0] - goal[0]))
