"""Distinguishes motion from relocalisation: a pose stream is continuous, a corrected map is not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

_Pose: TypeAlias = tuple[float, Sequence[float], Sequence[float]]


class JumpTest:
    """Compares every pose with the last one that was accepted.

    A pose that no plausible motion explains is a jump. The poses after it are jumps too, until either
    they are back where motion explains them (an outlier), or `reaccept_after` of them in a row agree
    with each other: then the stream goes on from the new place.

    Args:
        distance_m, angle_rad: step that is allowed at any time.
        speed_m_s, rate_rad_s: motion that is allowed beside it.
        reaccept_after: number of poses that must agree.
    """

    def __init__(
        self, *, distance_m: float, angle_rad: float, speed_m_s: float, rate_rad_s: float, reaccept_after: int
    ) -> None:
        self._distance_m, self._speed_m_s = distance_m, speed_m_s
        self._angle_rad, self._rate_rad_s = angle_rad, rate_rad_s
        self._reaccept_after = reaccept_after
        self.reset()

    @classmethod
    def of(cls, limits: Any) -> JumpTest:
        """The test of a sensor's table: `jump_distance_m`, `jump_angle_rad`, `max_speed_m_s`, ..."""
        return cls(
            distance_m=limits.jump_distance_m,
            angle_rad=limits.jump_angle_rad,
            speed_m_s=limits.max_speed_m_s,
            rate_rad_s=limits.max_rate_rad_s,
            reaccept_after=limits.reaccept_after,
        )

    def reset(self) -> None:
        """Accept the next pose."""
        self._believed: _Pose | None = None
        self._candidate: _Pose | None = None
        self._agreeing = 0
        self._trusting = True

    def distrust(self) -> None:
        """The frame of the poses has changed: accept none until poses agree with each other."""
        self.reset()
        self._trusting = False

    def jumped(self, t_s: float, position_m: Sequence[float], quaternion_wxyz: Sequence[float]) -> bool:
        """Whether this pose cannot follow from the last accepted one."""
        pose = (t_s, position_m, quaternion_wxyz)
        known = self._believed
        if self._trusting if known is None else self._continues(known, pose):
            self._believed, self._candidate, self._agreeing = pose, None, 0
            return False
        agrees = self._candidate is not None and self._continues(self._candidate, pose)
        self._agreeing = self._agreeing + 1 if agrees else 1
        self._candidate = pose
        if self._agreeing > self._reaccept_after:
            self._believed, self._candidate, self._agreeing = pose, None, 0
            return False
        return True

    def _continues(self, before: _Pose, after: _Pose) -> bool:
        (t_s, position_m, (aw, ax, ay, az)), (before_s, before_m, (bw, bx, by, bz)) = after, before
        dt_s = abs(t_s - before_s)
        if math.dist(position_m, before_m) > self._distance_m + self._speed_m_s * dt_s:
            return False
        overlap = abs(aw * bw + ax * bx + ay * by + az * bz)
        turn_rad = 2.0 * math.acos(overlap) if overlap < 1.0 else 0.0
        return turn_rad <= self._angle_rad + self._rate_rad_s * dt_s
