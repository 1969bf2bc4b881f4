"""Compares the tilt by the IMU with `environment.tilt_rad`.

The bench file alone would let a robot on a wall count as one that nothing can make fall. Offsets of a chip
and mounts that are slightly off do not count: only a difference at which wheels no longer hold a robot by
themselves does.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hil.config.bench import BenchConfig
from hil.config.device import ImuConfig
from hil.config.environment import LEAST_FRICTION
from hil.config.servos import ServosConfig
from hil.core.clock import nanoseconds
from hil.core.errors import ConfigError
from hil.core.finding import Finding
from hil.core.geometry import rotated
from hil.core.signals import ImuSample, Status
from hil.robot.statics import GRAVITY_M_S2

IMU = "imu"
_OK = Status.OK
APART_RAD = math.atan(LEAST_FRICTION)
"""24 deg: on a slope of that size tyres on the worst known surface begin to slide."""
_CALM_M_S2 = 2.0
"""By how much the mean of gravity may differ from 9.81 m/s^2; that of nonsense differs by more."""
_SAMPLES, _FRESH_NS = 10, nanoseconds(1.0)
_REMEDY = (
    "set environment.tilt_rad and surface to what the robot stands on; if they are right, the IMU is mounted "
    "otherwise than the bench file says: set imu.mount_rotation_wxyz (and imu.axis_map, where it has one)"
)


def tilt_rad(config: BenchConfig, samples: Sequence[ImuSample]) -> float:
    """Angle between the body's up axis and gravity's, by the IMU: 0 on a floor, pi/2 on a wall.

    Args:
        config: of the bench; its mount of the IMU counts.
        samples: good ones.

    Returns:
        rad; NaN where there is no sample, or where their mean is no gravity.
    """
    if not samples:
        return math.nan
    mount = config.of(ImuConfig) or ImuConfig()
    up = rotated(mount.mount_rotation_wxyz, np.mean([s.gravity_m_s2 for s in samples], axis=0).tolist())
    size_m_s2 = math.hypot(*up)
    if not abs(size_m_s2 - GRAVITY_M_S2) <= _CALM_M_S2:  # NaN is none either
        return math.nan
    return math.acos(max(-1.0, min(1.0, up[2] / size_m_s2)))


def sees_the_tilt(config: BenchConfig) -> bool:
    """Whether the bench has an IMU on the robot of its servos."""
    devices = config.devices()
    return IMU in devices and config.of(ServosConfig) is not None and IMU not in config.elsewhere()


class TiltWatch:
    """What the IMU of the servos' robot has said of gravity lately.

    Args:
        config: of the bench.
    """

    def __init__(self, config: BenchConfig) -> None:
        self._config, self._there = config, sees_the_tilt(config)
        self._newest: deque[ImuSample] = deque(maxlen=_SAMPLES)

    def saw(self, samples: Iterable[ImuSample]) -> None:
        """Take samples, oldest first; good ones count, those of the last second."""
        if self._there:
            for sample in samples:
                if sample.status is _OK:
                    self._newest.append(sample)

    def forget(self) -> None:
        """Forget where the robot was: it may have been moved since."""
        self._newest.clear()

    @property
    def known(self) -> bool:
        """Whether enough has been seen to judge, or there is nothing to wait for."""
        return not self._there or len(self._fresh()) == _SAMPLES

    @property
    def begun(self) -> bool:
        """Whether some has been seen, and too little yet to judge: on a busy computer samples come late."""
        return 0 < len(self._fresh()) < _SAMPLES

    def _fresh(self) -> list[ImuSample]:
        newest = self._newest
        return [s for s in newest if newest[-1].stamp.t_ns - s.stamp.t_ns <= _FRESH_NS]

    def apart_rad(self) -> float:
        """By how much the robot is steeper than the bench file says; NaN where no sensor has measured it."""
        if not self._there or not self.known:
            return math.nan
        return tilt_rad(self._config, self._fresh()) - self._config.environment.tilt_rad

    def steeper(self) -> str:
        """What speaks against the bench file where the robot is steeper than it says; empty where nothing."""
        return self._in_words() if self.apart_rad() > APART_RAD else ""

    def must_agree(self) -> None:
        """Refuse to set a robot in motion that stands otherwise than the bench file says.

        Raises:
            ConfigError: the IMU shows another tilt than `environment.tilt_rad`.
        """
        if abs(self.apart_rad()) > APART_RAD:
            raise ConfigError(
                f"{self._config.name}: environment.tilt_rad: {self._in_words()}; nothing is moved",
                expected=f"less than {math.degrees(APART_RAD):.0f} deg between them",
                remedy=_REMEDY,
            )

    def _in_words(self) -> str:
        return "the IMU shows the robot " + _tilt_text(self._config, tilt_rad(self._config, self._fresh()))


def _tilt_text(config: BenchConfig, seen_rad: float) -> str:
    claimed_deg = math.degrees(config.environment.tilt_rad)
    return f"tilted by {math.degrees(seen_rad):.0f} deg, bench file says {claimed_deg:.0f}"


def tilt_finding(config: BenchConfig, seen: Mapping[str, Sequence[Any]]) -> Iterator[Finding]:
    """Findings on gravity's direction; none without an IMU on the servos' robot that has measured it.

    Args:
        config: of the bench.
        seen: samples of every kind that was watched.
    """
    good = [s for s in seen.get(IMU, ()) if s.status is Status.OK]
    seen_rad = tilt_rad(config, good)
    if not sees_the_tilt(config) or math.isnan(seen_rad):
        return
    agrees = abs(seen_rad - config.environment.tilt_rad) <= APART_RAD
    yield Finding(
        IMU,
        "tilt",
        "ok" if agrees else "failure",
        _tilt_text(config, seen_rad),
        f"less than {math.degrees(APART_RAD):.0f} deg between them",
        _REMEDY,
    )
