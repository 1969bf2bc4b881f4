"""Compares gravity and turn rate of the IMU at rest with the results of `imu_calibration` in the record.

On a wall, gravity and motion capture both give the heading. With the IMU mount in the record they agreed, so
their difference at rest is the rotation of the IMU, or of the rigid body of motion capture, since then, even
while no program ran. The turn rate of a robot at rest is the gyro's bias.
"""

import math
from collections.abc import Iterable, Iterator

from hil.config.bench import BenchConfig
from hil.config.robot_record.overlay import known_parts
from hil.config.robot_record.parts import Part
from hil.core.errors import DeviceError
from hil.core.finding import Finding
from hil.core.geometry import mean_angle, wrap
from hil.core.signals import GyroMeasurement, Measurements
from hil.loop.driven_motion import Motion

WARN_RAD = 0.03
"""Error of heading for a warning: an accelerometer that has warmed up by 20 K is off by 0.02 rad. A larger
one contradicts the bench file (`hil.bench.cross_checks.gravity`)."""
WARN_RAD_S, STOP_RAD_S = math.radians(0.1), math.radians(3.0)
"""Change of the turn rate for a warning, and for a filter without the IMU: the limit of `imu_calibration`,
and of the data sheet (BST-BNO055-DS000)."""
_FEWEST = 20
"""Smallest number of samples of each sensor; the noise is then at most a fifth of the limit for a warning."""


def inertial_changes(config: BenchConfig, measured: Iterable[Measurements]) -> Iterator[Finding]:
    """Findings on changes of the IMU since the record's part `inertial`; none without record or samples.

    Args:
        config: the bench configuration.
        measured: aligned measurements of a robot at rest.
    """
    elsewhere = config.elsewhere()
    part = None if "imu" in elsewhere else known_parts(config).get("inertial")
    if part is None:
        return
    gyro, seen_rad = list[GyroMeasurement](), list[float]()
    for one in measured:
        gyro += one.gyro
        seen_rad += [] if "mocap" in elsewhere else [float(m.pose[2]) for m in one.mocap if m.valid]
    kept = part.figures.get("gyro_bias")
    if len(gyro) >= _FEWEST and kept is not None:
        rate_rad_s = math.fsum(g.yaw_rate_rad_s for g in gyro) / len(gyro)
        yield _bias(part, rate_rad_s - math.radians(kept.value))
    felt_rad = [g.gravity_heading_rad for g in gyro if math.isfinite(g.gravity_heading_rad)]
    if min(len(felt_rad), len(seen_rad)) >= _FEWEST and "imu.mount_rotation_wxyz" in part.values:
        yield _heading(part, wrap(mean_angle(felt_rad) - mean_angle(seen_rad)))


def _bias(part: Part, changed_rad_s: float) -> Finding:
    size_rad_s = abs(changed_rad_s)
    return Finding(
        "imu",
        "gyro bias",
        "ok" if size_rad_s <= WARN_RAD_S else "warning" if size_rad_s <= STOP_RAD_S else "failure",
        f"{math.degrees(changed_rad_s):+.2f} deg/s at rest since it was measured ({part.measured[:10]})",
        f"within {math.degrees(WARN_RAD_S):g} deg/s",
        "let the robot rest; if it stays, run `hil run imu_calibration`",
    )


def _heading(part: Part, turned_rad: float) -> Finding:
    return Finding(
        "imu",
        "heading against motion capture",
        "ok" if abs(turned_rad) <= WARN_RAD else "warning",
        f"{turned_rad:+.3f} rad ({math.degrees(turned_rad):+.1f} deg) since it was measured "
        f"({part.measured[:10]})",
        f"within {WARN_RAD:g} rad",
        "imu.mount_rotation_wxyz or mocap.body is no longer as measured: `hil run imu_calibration`",
    )


class InertialWatch:
    """State of the IMU as measured during the latest rest of the robot.

    Args:
        config: the bench configuration.
    """

    def __init__(self, config: BenchConfig) -> None:
        self._config = config
        self._changed: list[Finding] = []

    def rested(self, motion: Motion) -> Iterator[str]:
        """Process the measurements of a rest, after opening devices or after a motion; yields warnings."""
        found = inertial_changes(self._config, (r.measurements for r in motion.records))
        self._changed = [finding for finding in found if finding.level != "ok"]
        for finding in self._changed:
            yield f"{_in_words(finding)}; {finding.remedy}"

    def must_be_usable(self) -> None:
        """Refuse to move by a filter that uses a gyro whose bias has changed by far.

        Raises:
            DeviceError: gives the change and the limit.
        """
        for finding in self._changed:
            if finding.level == "failure":
                raise DeviceError("imu", f"{_in_words(finding)}; nothing is moved", remedy=finding.remedy)


def _in_words(finding: Finding) -> str:
    return f"{finding.check}: {finding.found}, {finding.expected} is allowed"
