"""Checks that propellers without feedback obey their commands, and keep running when the bench has ended.

They do not acknowledge commands. A controller that does not understand a command lowers its throttle, and the
robot slides seconds later: so they count once the robot has been at rest for that long. A bench that closes
sends them nothing meanwhile, to test them without commands; a bench that continues repeats their set-point,
because they may restart.
"""

import math
from dataclasses import replace

from hil.config.thrust import ThrustConfig
from hil.core.clock import NS_PER_S, nanoseconds
from hil.loop.device_set import DeviceSet
from hil.robot.statics import Statics

_PAUSE_S = 0.6
"""Observation time for propellers to which the bench sends nothing at all."""
_BLIND_NS = nanoseconds(0.3)
"""Largest gap in the observation: a slide that has begun is also detected afterwards."""
_BETTER = 1.2
"""Factor on the assumed friction; with more friction the robot slides later."""
_HALVINGS = 8


class PropellerObservation:
    """Observation time of propellers without feedback.

    Args:
        devices: devices of the bench.
        propellers: settings of propellers that report nothing; None if there are none, or they have no model.
        asked_n: their force set-point, N.
    """

    def __init__(self, devices: DeviceSet, propellers: ThrustConfig | None, asked_n: float) -> None:
        self._devices, self._propellers, self._asked_n = devices, propellers, asked_n
        self._since_ns: int | None = None
        self._seen_ns = 0
        self._for_good = False

    @property
    def begun(self) -> bool:
        """Whether the observation of the resting robot has begun."""
        return self._since_ns is not None

    def begin(self, *, for_good: bool) -> None:
        """Begin a check; `for_good`: the bench closes and sends no commands meanwhile."""
        self.end()
        self._for_good = for_good

    def end(self) -> None:
        """End the observation and resume sending commands."""
        if self._since_ns is not None:
            self._since_ns = None
            self._leave(alone=False)

    def left_s(self, now_ns: int, *, rests: bool, moves: bool, least_n: float) -> float:
        """Remaining time at rest before the propellers count, s; 0 once they do.

        `inf` while no sensor shows the robot at rest, or if the time that they need to let it slide is
        unknown.

        Args:
            now_ns: present time.
            rests: True if a sensor shows the robot at rest; after a longer gap the observation restarts.
            moves: True if a sensor shows motion: then the commands resume at once.
            least_n: push below which the robot would slide, N; 0 if unknown.
        """
        if not rests:
            if moves or now_ns - self._seen_ns > _BLIND_NS:
                self.end()
            return math.inf
        self._seen_ns, needs_s = now_ns, self._needs_s(least_n)
        if not math.isfinite(needs_s):
            self.end()
            return math.inf
        if self._since_ns is None:
            self._since_ns = now_ns
            self._leave(alone=True)
        return max(needs_s - (now_ns - self._since_ns) / NS_PER_S, 0.0)

    def _needs_s(self, least_n: float) -> float:
        if self._devices.get("thrust") is None:
            return _PAUSE_S
        known = self._propellers
        return math.inf if known is None else known.force_lost_after_s(self._asked_n, least_n)

    def _leave(self, *, alone: bool) -> None:
        device = self._devices.get("thrust")
        if self._for_good and device is not None and self._propellers is not None:
            device.leave_alone(alone)


def least_push_n(statics: Statics, force_n: float, most_n: float, heading_rad: float) -> float:
    """Push along the body (N) below which the robot slides even with more friction than assumed.

    Args:
        statics: statics of robot and surface.
        force_n: adhesion force, N.
        most_n: push with which the robot holds, N.
        heading_rad: heading of the body on the surface.
    """
    better = replace(statics, friction=_BETTER * statics.friction)
    low_n, high_n = 0.0, most_n
    if better.needed_n(low_n, heading_rad) <= force_n:
        return 0.0
    for _ in range(_HALVINGS):
        middle_n = 0.5 * (low_n + high_n)
        holds = better.needed_n(middle_n, heading_rad) <= force_n
        low_n, high_n = (low_n, middle_n) if holds else (middle_n, high_n)
    return low_n
