"""Stops the robot when a sensor is lost while it is driven."""

from hil.loop.checks.exclusion import Exclusion
from hil.loop.checks.sensor_status import SensorStatus
from hil.loop.cycle_data import Check, Cycle
from hil.loop.safety_limits import Checks


class LostCheck(Check):
    """Stops a driven robot when a sensor is lost for too long, or a needed camera gives no poses.

    Args:
        samples: check with the ages of all samples.
        checks: checks of the bench, for `needs_camera` and `lost_after_s`.
        excluded: devices that are excluded.
    """

    def __init__(self, samples: SensorStatus, checks: Checks, excluded: Exclusion) -> None:
        self._samples, self._checks, self._excluded = samples, checks, excluded

    def on_samples(self, cycle: Cycle) -> None:
        """Check for lost sensors; stops with `stale_tracker` or `lost_KIND`."""
        t_ns = cycle.inputs.t_ns
        followed = self._checks.needs_camera and "tracker" not in self._excluded
        silence = self._samples.silence("tracker", t_ns) if followed else ""
        if silence:
            cycle.stop(
                "stale_tracker",
                f"no usable pose of the camera {silence}, which the estimate that is followed needs: check "
                "its lens, light and cable, or follow odometry",
            )
        for name, limit_s in self._checks.lost_after_s.items():
            away_s = self._samples.away_s(name, t_ns)
            if away_s > limit_s:
                remedy = "check its cable and power, then start the motion again"
                cycle.stop(f"lost_{name}", f"nothing from {name} for {away_s:.1f} s: {remedy}")
