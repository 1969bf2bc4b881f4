"""Finds the heading up to which a robot holds on its wall: a search by placing it at different headings."""

import math

from hil.core.errors import SafetyStop
from hil.procedure import Context
from hil.procedures.surface_identification.slip import held

_TETHERED = {"safety.tethered": True, "safety.heading_limit_rad": math.pi / 2}
WITHOUT = {"encoders": None, "tracker": None}
"""Bench file sections to leave out: devices that are not needed to find slip and hold."""


def hold_angle(ctx: Context, low: float, high: float, step: float, sense: float) -> list[float | None]:
    """Bisect the heading between standing and sliding; return both ends of the last step, and the force.

    Args:
        ctx: context of the run.
        low: smallest heading, deg.
        high: largest heading, deg.
        step: largest distance of the two ends, deg.
        sense: side: 1 to the left, -1 to the right.

    Returns:
        Headings in deg: the second is None if the robot still stood at the largest heading, the first if it
        slid at the smallest. Then the measured force of the fan, N; None without a sensor.
    """
    stood, force_n = stands(ctx, sense * low)
    if not stood:
        return [None, low, force_n]
    if stands(ctx, sense * high)[0]:
        return [high, None, force_n]
    while high - low > step:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stands(ctx, sense * middle)[0] else (low, middle)
        ctx.progress("hold", 1, 1)
    return [low, high, force_n]


def stands(ctx: Context, heading_deg: float) -> tuple[bool, float | None]:
    """Place the robot on the wall with locked wheels; return whether it stays, and the fan's force, N."""
    x_m, y_m, _ = ctx.source.config.environment.start_pose
    pose = (x_m, y_m, math.radians(heading_deg))
    bench = ctx.reopen(
        f"hold {'left' if heading_deg > 0 else 'right'} {abs(heading_deg):.2f} deg",
        overrides={**WITHOUT, **_TETHERED, "environment.start_pose": pose},
        prompt=f"tether the robot, hold it at a heading of {heading_deg:+.2f} deg, press Enter, let go",
    )
    bench.devices.actuators().enable()
    try:
        motion = bench.observe(1.5, feedback="odometry", start_pose=pose)
    except SafetyStop:
        return False, None
    return held(motion), motion.records[-1].state.diagnostics.get("adhesion_n")
