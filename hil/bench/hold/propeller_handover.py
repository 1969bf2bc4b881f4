"""Checks that propellers without feedback obey their commands, and go on when the bench has ended.

Nothing confirms their commands. A controller that does not understand them takes its throttle down, and the
robot slides seconds later: they count once it has been seen at rest for as long as that. A bench that closes
sends them nothing meanwhile, so that what is seen is what they do alone; a bench that goes on sends
their force again and again, because they may restart.
"""

from __future__ import annotations

import math
from dataclasses import replace

from hil.config.thrust import ThrustConfig
from hil.core.clock import NS_PER_S, nanoseconds
from hil.loop.device_set import DeviceSet
from hil.robot.statics import Statics

_PAUSE_S = 0.6
"""To look at propellers to which the bench sends nothing at all."""
_BLIND_NS = nanoseconds(0.3)
"""The robot may be unseen for so long: a slide that has begun is seen after that, too."""
_BETTER = 1.2
"""So many times the friction that is believed a surface may have: on it a robot slides later."""
_HALVINGS = 8


class LeftAlone:
    """Of one bench.

    Args:
        rig: its devices.
        propellers: that report nothing; None where there are none that the bench knows how to reckon with.
        asked_n: what they are asked for.
    """

    def __init__(self, rig: DeviceSet, propellers: ThrustConfig | None, asked_n: float) -> None:
        self._rig, self._propellers, self._asked_n = rig, propellers, asked_n
        self._since_ns: int | None = None
        self._seen_ns = 0
        self._for_good = False

    @property
    def begun(self) -> bool:
        """Whether the robot is seen at rest now, and they do not count yet, or do."""
        return self._since_ns is not None

    def begin(self, *, for_good: bool) -> None:
        """A look begins; `for_good`: the bench closes, and leaves them alone."""
        self.end()
        self._for_good = for_good

    def end(self) -> None:
        """Let the bench go on telling them."""
        if self._since_ns is not None:
            self._since_ns = None
            self._leave(alone=False)

    def left_s(self, now_ns: int, *, rests: bool, moves: bool, least_n: float) -> float:
        """How much longer the robot is to rest until they count; 0 once they do.

        `inf` while no sensor sees it rest, and where it is not known how long they need to let it slide.

        Args:
            now_ns: time.
            rests: whether a sensor sees the robot at rest; where not for a while, it begins anew.
            moves: whether it is seen not to rest: then they are sent their force again at once.
            least_n: push below which the robot would slide; 0 where that is not known.
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
        if self._rig.get("thrust") is None:
            return _PAUSE_S
        known = self._propellers
        return math.inf if known is None else known.gives_way_s(self._asked_n, least_n)

    def _leave(self, *, alone: bool) -> None:
        device = self._rig.get("thrust")
        if self._for_good and device is not None and self._propellers is not None:
            device.leave_alone(alone)


def least_push_n(statics: Statics, force_n: float, most_n: float, heading_rad: float) -> float:
    """Push along the body below which a robot surely slides, on a surface that may be better than believed.

    Args:
        statics: of robot and surface.
        force_n: that presses it.
        most_n: push with which it holds.
        heading_rad: of the body on the surface.
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
