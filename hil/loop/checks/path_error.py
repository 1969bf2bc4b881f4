"""Stops the robot when its heading or position is too far from the reference."""

import math

from hil.core.errors import SafetyStop
from hil.core.geometry import wrap
from hil.loop.cycle_data import Check, Cycle
from hil.loop.safety_limits import SafetyLimits


class PathCheck(Check):
    """Limits heading and distance from the reference, before the robot loses its hold or leaves its path.

    Args:
        limits: limits of the bench.
    """

    def __init__(self, limits: SafetyLimits) -> None:
        self._steepest_rad = limits.heading_limit_rad if limits.on_wall else math.inf
        self._farthest_m = limits.tracking_error_limit_m

    def on_estimate(self, cycle: Cycle) -> None:
        """Check the estimate; stops with `heading`, `tracking`, or `not_finite` for the reference."""
        assert cycle.state is not None
        x_m, y_m, heading_rad = cycle.state.pose_body_in_wall.tolist()
        steepest = self._steepest_rad
        if not -steepest <= heading_rad <= steepest and abs(wrap(heading_rad)) > steepest:
            cycle.stop(
                "heading",
                f"heading {math.degrees(heading_rad):.1f} deg exceeds "
                f"{math.degrees(steepest):.1f} deg: the robot would lose its hold",
            )
        if cycle.reference is not None:
            wanted_x_m, wanted_y_m, wanted_rad = cycle.reference.pose_in_wall.tolist()
            if not math.isfinite(wanted_x_m + wanted_y_m + wanted_rad):
                raise SafetyStop("not_finite", "the reference is not finite")
            error_m = math.hypot(wanted_x_m - x_m, wanted_y_m - y_m)
            if error_m > self._farthest_m:
                cycle.stop("tracking", f"{error_m:.3f} m from the reference")
