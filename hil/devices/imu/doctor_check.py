"""What the doctor asks of an inertial unit: samples, its own calibration, and gravity."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hil.core.finding import Finding, Level
from hil.core.signals import Status
from hil.devices.doctor_watch import Watched, losses
from hil.robot.statics import GRAVITY_M_S2

_TOLERANCE_M_S2 = 0.5


def look(watched: Watched) -> Iterator[Finding]:
    """Findings about an inertial unit that was watched."""
    yield losses("imu", (s.status for s in watched.samples), watched.due, "check wiring and baud rate")
    good = [s for s in watched.samples if s.status is Status.OK]
    if not good:
        return
    if good[-1].calibration:
        system, gyro, accelerometer, magnetometer = good[-1].calibration
        calibrated: Level = "ok" if min(gyro, accelerometer) >= 2 else "warning"
        yield Finding(
            "imu",
            "calibration",
            calibrated,
            f"system {system} gyro {gyro} accelerometer {accelerometer} magnetometer {magnetometer}",
            "gyro and accelerometer 2 or more",
            "hil run imu_calibration, or rest and tilt the robot",
        )
    norm = float(np.mean([np.linalg.norm(s.gravity_m_s2) for s in good]))
    level: Level = "ok" if abs(norm - GRAVITY_M_S2) < _TOLERANCE_M_S2 else "failure"
    yield Finding(
        "imu", "gravity", level, f"{norm:.2f} m/s^2", f"{GRAVITY_M_S2:.2f} m/s^2", "check the axis remap"
    )
