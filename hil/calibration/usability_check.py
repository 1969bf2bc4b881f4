"""Checks that a bench may use a calibration: it is for this robot and did not fail its validation run."""

import numpy as np

from hil.calibration.calibration_file import CalibrationFile, MadeFor
from hil.config.bench import BenchConfig
from hil.config.servos import ServosConfig
from hil.core.errors import ConfigError
from hil.core.result_names import PASSED
from hil.robot.kinematics import WheelGeometry

_SAME_M = 1e-6
_SAME_RAD = 1e-6


def made_for(config: BenchConfig) -> MadeFor | None:
    """Servos of a bench as stored in a calibration; None for a bench without servos."""
    servos = config.of(ServosConfig)
    if servos is None:
        return None
    alignment = config.alignment
    return MadeFor(
        servo_model=servos.model_number,
        drive_ids=servos.drive_ids,
        steer_ids=servos.steer_ids,
        drive_sign=alignment.drive_sign,
        steer_sign=alignment.steer_sign,
        steer_zero_rad=alignment.steer_zero_rad,
    )


def check_passed(file: CalibrationFile, path: str) -> None:
    """Refuse a calibration whose validation run did not pass, or that had no such run.

    Args:
        file: the calibration.
        path: path of the file, for the message.

    Raises:
        ConfigError: names the file and the verdict.
    """
    if file.verdict not in PASSED:
        raise ConfigError(
            f"{path}: version {file.version} has not passed a validation run "
            f"(verdict {file.verdict or 'none'})",
            expected=f"the verdict {' or '.join(PASSED)}",
            remedy="calibrate with `hil run odometry_calibration`, which ends in one",
        )


def failed_validation(file: CalibrationFile, path: str) -> str:
    """A sentence where the calibration failed its own validation run; else empty.

    Args:
        file: the calibration.
        path: path of the file, for the message.
    """
    if file.verdict != "FAIL":
        return ""
    return f"{path}: version {file.version} failed its validation run (verdict FAIL)"


def check_usable(file: CalibrationFile, config: BenchConfig, path: str) -> None:
    """Refuse a calibration of another robot, or one that failed its validation run.

    A calibration without such a run (from `hil calibrate`) is allowed, and a failed one where the bench
    allows it.

    Args:
        file: the calibration.
        config: bench that is to use it.
        path: path of the file, for the message.

    Raises:
        ConfigError: names the file and what is wrong.
    """
    check_made_for(file, config, path)
    check_not_failed(file, config, path)
    if file.coupling is not None:
        raise ConfigError(
            f"{path}: was fitted to recordings without the coupling of the steering into the drive encoders "
            "(`coupling`), which the bench does not take out",
            expected="a calibration without `coupling`",
            remedy="let the drive encoders' source take the coupling out, and calibrate again",
        )


def check_not_failed(file: CalibrationFile, config: BenchConfig, path: str) -> None:
    """Refuse a calibration that failed its validation run, unless the bench file allows it.

    Args:
        file: the calibration.
        config: bench that is to use it.
        path: path of the file, for the message.

    Raises:
        ConfigError: names the file.
    """
    failed = failed_validation(file, path)
    if failed and not config.failed_calibration:
        raise ConfigError(
            failed,
            expected="a calibration that passed one",
            remedy="calibrate with `hil run odometry_calibration`, go back with `hil calibration rollback`, "
            "or use it all the same: failed_calibration = true in the bench file",
        )


def check_made_for(file: CalibrationFile, config: BenchConfig, path: str) -> None:
    """Refuse a calibration of another robot.

    Args:
        file: the calibration.
        config: bench that is to use it.
        path: path of the file, for the message.

    Raises:
        ConfigError: nominal geometry or servos differ from the bench's; lists all differences.
    """
    robot = config.robot
    mine = WheelGeometry(
        np.array(robot.wheel_x_m), np.array(robot.wheel_y_m), np.array(robot.wheel_radius_m)
    ).vector()[:12]
    problems = []
    other = file.nominal_geometry.vector()[:12]
    for name, at in (("wheel_x_m", 0), ("wheel_y_m", 4), ("wheel_radius_m", 8)):
        if not np.allclose(mine[at : at + 4], other[at : at + 4], rtol=0.0, atol=_SAME_M):
            problems.append(
                f"robot.{name}: {other[at : at + 4].tolist()} there, {mine[at : at + 4].tolist()} here"
            )
    problems += _other_servos(file.made_for, made_for(config))
    if problems:
        raise ConfigError(
            f"{path}: the calibration was made for another robot than the bench {config.name!r}",
            problems=tuple(problems),
            remedy="calibrate this robot, or correct the bench file",
        )


def _other_servos(there: MadeFor | None, here: MadeFor | None) -> list[str]:
    if there is None or here is None:
        return []
    sections = {
        "servo_model": "servos.model_number",
        "drive_ids": "servos.drive_ids",
        "steer_ids": "servos.steer_ids",
    }
    problems = []
    for name in MadeFor.model_fields:
        if getattr(there, name) is None or getattr(here, name) is None:
            continue
        a, b = np.atleast_1d(getattr(there, name)), np.atleast_1d(getattr(here, name))
        if not np.allclose(a, b, rtol=0.0, atol=_SAME_RAD):
            key = sections.get(name, f"alignment.{name}")
            problems.append(f"{key}: {getattr(there, name)} there, {getattr(here, name)} here")
    return problems
