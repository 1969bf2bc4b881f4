"""Compares the tilt by the IMU with `environment.tilt_rad`.

With a wrong bench file a robot on a wall would count as one that cannot fall. Sensor offsets and small
mounting errors are tolerated: only a difference at which wheels alone no longer hold a robot counts.
"""

import math
from collections import deque
from collections.abc import Iterable, Sequence

import numpy as np

from hil.config.bench import BenchConfig
from hil.config.device import ImuConfig
from hil.config.environment import LEAST_FRICTION
from hil.config.servos import ServosConfig
from hil.core.clock import nanoseconds
from hil.core.errors import ConfigError
from hil.core.geometry import Three, rotated
from hil.core.signals import ImuSample, Status
from hil.robot.statics import GRAVITY_M_S2

IMU = "imu"
_OK = Status.OK
APART_RAD = math.atan(LEAST_FRICTION)
"""24 deg: on a slope of that size tyres on the worst known surface begin to slide."""
_CALM_M_S2 = 2.0
"""Largest plausible difference of the mean gravity from 9.81 m/s^2."""
_SAMPLES, _FRESH_NS = 10, nanoseconds(1.0)
_REMEDY = (
    "set environment.tilt_rad and surface to what the robot stands on; if they are right, the IMU is mounted "
    "otherwise than the bench file says: set imu.mount_rotation_wxyz (and imu.axis_map, where it has one)"
)


def up_by_imu(config: BenchConfig, samples: Sequence[ImuSample]) -> Three | None:
    """Unit vector against gravity in the body, by the IMU.

    Args:
        config: the bench configuration, with the mount of the IMU.
        samples: good samples.

    Returns:
        The vector; None without samples, or if the magnitude of their mean is not that of gravity.
    """
    if not samples:
        return None
    mount = config.of(ImuConfig) or ImuConfig()
    up = rotated(mount.mount_rotation_wxyz, np.mean([s.gravity_m_s2 for s in samples], axis=0).tolist())
    size_m_s2 = math.hypot(*up)
    if not abs(size_m_s2 - GRAVITY_M_S2) <= _CALM_M_S2:  # also true for NaN
        return None
    return up[0] / size_m_s2, up[1] / size_m_s2, up[2] / size_m_s2


def tilt_rad(config: BenchConfig, samples: Sequence[ImuSample]) -> float:
    """Angle between the body's up axis and gravity's, by the IMU: 0 on a floor, pi/2 on a wall.

    Args:
        config: the bench configuration, with the mount of the IMU.
        samples: good samples.

    Returns:
        Tilt, rad; NaN if it is not known.
    """
    up = up_by_imu(config, samples)
    return math.nan if up is None else math.acos(max(-1.0, min(1.0, up[2])))


def sees_the_tilt(config: BenchConfig) -> bool:
    """Whether the bench has servos, and an IMU in the same world."""
    devices = config.devices()
    return IMU in devices and config.of(ServosConfig) is not None and IMU not in config.elsewhere()


class TiltWatch:
    """Recent gravity measurements of the IMU on the servos' robot.

    Args:
        config: configuration of the bench.
    """

    def __init__(self, config: BenchConfig) -> None:
        self._config, self._there = config, sees_the_tilt(config)
        self._newest: deque[ImuSample] = deque(maxlen=_SAMPLES)

    def saw(self, samples: Iterable[ImuSample]) -> None:
        """Add samples, oldest first; only good ones of the last second count."""
        if self._there:
            for sample in samples:
                if sample.status is _OK:
                    self._newest.append(sample)

    def forget(self) -> None:
        """Discard all samples: the robot may have been moved."""
        self._newest.clear()

    @property
    def known(self) -> bool:
        """Whether there are enough samples to decide, or no IMU to wait for."""
        return not self._there or len(self._fresh()) == _SAMPLES

    @property
    def measured(self) -> bool:
        """Whether an IMU of this robot has measured gravity."""
        return math.isfinite(self.apart_rad())

    @property
    def begun(self) -> bool:
        """Whether there are samples, but too few to decide: on a busy computer they come late."""
        return 0 < len(self._fresh()) < _SAMPLES

    def _fresh(self) -> list[ImuSample]:
        newest = self._newest
        return [s for s in newest if newest[-1].stamp.t_ns - s.stamp.t_ns <= _FRESH_NS]

    def apart_rad(self) -> float:
        """Measured minus configured tilt, rad; NaN if not measured."""
        if not self._there or not self.known:
            return math.nan
        return tilt_rad(self._config, self._fresh()) - self._config.environment.tilt_rad

    def steeper(self) -> str:
        """Message if the robot is steeper than the bench file says; else empty."""
        return self._in_words() if self.apart_rad() > APART_RAD else ""

    def must_agree(self) -> None:
        """Refuse to move a robot whose tilt differs from the bench file.

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
