"""Drives towards the plate: the range finder has to see the way that motion capture would see."""

from __future__ import annotations

import numpy as np

from hil.core.signals import Status
from hil.procedure import Context, Measurement, procedure
from hil.procedure.tracking_errors import enable_hold
from hil.robot.trajectories import line

_MEAN_OF, _UP = 20, np.array([0.05, 0.0, 0.0])


@procedure(
    name="approach",
    needs=("servos", "rangefinder"),
    measurements=[
        Measurement("seen", "mm", low=45.0, high=55.0, rationale="5 cm, and what a wheel may slip on the way")
    ],
)
def run(ctx: Context) -> None:
    """Drive 5 cm up and measure by how much the plate has come nearer."""
    start = enable_hold(ctx.bench)
    with ctx.step("drive"):
        motion = ctx.bench.drive(line(start, start + _UP, duration_s=2.0), start_pose=start, hold_s=0.5)
    samples = [s for record in motion.records for s in record.inputs.of("rangefinder")]
    good = [s.distance_m for s in samples if s.status is Status.OK]
    ctx.measure("seen", 1e3 * (sum(good[:_MEAN_OF]) - sum(good[-_MEAN_OF:])) / _MEAN_OF)
