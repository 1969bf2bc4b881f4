"""The versions of one `calibration.toml`: new ones beside the old, one of them in place.

A bench names one file. Beside it stand all its versions (`calibration.v1.toml`, ...). A new version is
put there first; only after its validation passed is it copied into place, in one step. Any version
can be put back. What was made for another geometry or other servos is refused.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hil.calibration.artefact import (
    CalibrationFile,
    MadeFor,
    calibration_file,
    keep,
    kept_path,
    next_version,
    read_calibration,
    save_calibration,
)
from hil.config.bench import BenchConfig
from hil.config.record.parts import Identity
from hil.config.servos import ServosConfig
from hil.robot.kinematics import WheelGeometry
from hil.vocabulary.errors import ConfigError, reason_of
from hil.vocabulary.files import put_whole
from hil.vocabulary.reading import MOST_TOML_BYTES, read_bytes
from hil.vocabulary.result_files import PASSED

if TYPE_CHECKING:
    from hil.calibration.calibrate import Calibration

_SAME_M = 1e-6
_SAME_RAD = 1e-6


@dataclass(frozen=True)
class KeptVersion:
    """One version: its file, its content, and whether it is the one in place."""

    path: Path
    file: CalibrationFile
    in_place: bool


class Shelf:
    """All versions of a calibration file.

    Args:
        path: the file that benches name; need not exist yet.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def versions(self) -> tuple[KeptVersion, ...]:
        """Every version, oldest first; a damaged file raises `ConfigError`."""
        pattern = re.compile(re.escape(self.path.stem) + r"\.v(\d+)" + re.escape(self.path.suffix))
        try:
            current = read_bytes(self.path, MOST_TOML_BYTES) if self.path.exists() else None
        except (OSError, ValueError) as error:
            why = reason_of(error)
            raise ConfigError(f"{self.path}: cannot be read ({why})") from None
        found = [
            KeptVersion(p, read_calibration(p), p.read_bytes() == current)
            for p in self.path.parent.glob("*")
            if pattern.fullmatch(p.name)
        ]
        if current is not None and not any(v.in_place for v in found):
            found.append(KeptVersion(self.path, read_calibration(self.path), in_place=True))
        return tuple(sorted(found, key=lambda v: v.file.version))

    def add(self, file: CalibrationFile) -> KeptVersion:
        """Put a calibration beside the others, under the next number; what is in place stays."""
        version = next_version(self.path)
        previous = keep(self.path) if self.path.exists() else {}
        numbered = file.model_copy(update={"version": version, "previous": previous})
        target = kept_path(self.path, version)
        save_calibration(target, numbered)
        return KeptVersion(target, numbered, in_place=False)

    def apply(self, version: int, config: BenchConfig | None = None) -> KeptVersion:
        """Put a version in place.

        Args:
            version: its number.
            config: bench that is going to use it, None to check nothing of it.

        Raises:
            ConfigError: no such version, its validation did not pass, or it belongs to another robot.
        """
        chosen = self.find(version)
        check_passed(chosen.file, str(chosen.path))
        return self._put_in_place(chosen, config)

    def adopt(self, file: CalibrationFile, where: str, config: BenchConfig | None = None) -> KeptVersion:
        """Put a calibration from elsewhere beside the others and in place; a refused one leaves no file.

        Args:
            file: the calibration.
            where: it lies, for messages.
            config: bench that is going to use it, None to check nothing of it.

        Raises:
            ConfigError: its validation did not pass, it belongs to another robot, or it cannot be written.
        """
        check_passed(file, where)
        if config is not None:
            check_made_for(file, config, where)
        return self.apply(self.add(file).file.version, config)

    def rollback(self, version: int | None = None, config: BenchConfig | None = None) -> KeptVersion:
        """Put an earlier version back: the given one, else the one before the one in place.

        Raises:
            ConfigError: nothing to go back to, or it belongs to another robot.
        """
        if version is None:
            here = [v.file.version for v in self.versions() if v.in_place]
            earlier = [v.file.version for v in self.versions() if here and v.file.version < here[0]]
            if not earlier:
                raise ConfigError(f"{self.path}: no earlier version to go back to", expected=self._known())
            version = earlier[-1]
        return self._put_in_place(self.find(version), config)

    def find(self, version: int) -> KeptVersion:
        """The version of that number; raises `ConfigError` that lists the numbers."""
        for kept in self.versions():
            if kept.file.version == version:
                return kept
        raise ConfigError(f"{self.path}: no version {version}", expected=self._known())

    def _known(self) -> str:
        numbers = [str(v.file.version) for v in self.versions()]
        return "one of " + ", ".join(numbers) if numbers else "a calibration file there"

    def _put_in_place(self, chosen: KeptVersion, config: BenchConfig | None) -> KeptVersion:
        if config is not None:
            check_made_for(chosen.file, config, str(chosen.path))
        if self.path.exists():
            keep(self.path)
        try:
            put_whole(self.path, chosen.path.read_bytes())
        except OSError as error:
            raise ConfigError(f"{self.path}: cannot be written ({reason_of(error)})") from None
        return KeptVersion(chosen.path, chosen.file, in_place=True)


def shelve(
    path: Path,
    result: Calibration,
    *,
    created: str,
    software: dict[str, str],
    verdict: str,
    config: BenchConfig,
    robot: Identity,
) -> KeptVersion:
    """Put a calibration beside `path`, and in place if its validation passed.

    Args:
        path: the calibration in use, `calibration.toml`.
        result: to keep.
        created: date and time, ISO 8601.
        software: package name to version.
        verdict: of its validation run.
        config: bench that it was made on.
        robot: whose it is.
    """
    shelf = Shelf(path)
    kept = shelf.add(
        calibration_file(
            result,
            created=created,
            software=software,
            verdict=verdict,
            made_for=made_for(config),
            robot=robot,
        )
    )
    return shelf.apply(kept.file.version, config) if verdict in PASSED else kept


def made_for(config: BenchConfig) -> MadeFor | None:
    """The servos of a bench as a calibration remembers them; None for a bench without."""
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
    """Refuse a calibration whose validation run did not pass, or that had none.

    Args:
        file: the calibration.
        path: where it lies, for the message.

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


def check_usable(file: CalibrationFile, config: BenchConfig, path: str) -> None:
    """Refuse a calibration that a bench may not use: another robot's, or one that failed its validation run.

    One that had no such run (of `hil calibrate`) may be used, and a failed one where the bench asks for it.

    Args:
        file: the calibration.
        config: bench that is to use it.
        path: where it lies, for the message.

    Raises:
        ConfigError: names the file and what is wrong.
    """
    check_made_for(file, config, path)
    if file.verdict == "FAIL" and not config.failed_calibration:
        raise ConfigError(
            f"{path}: version {file.version} failed its validation run (verdict FAIL)",
            expected="a calibration that passed one",
            remedy="calibrate with `hil run odometry_calibration`, go back with `hil calibration rollback`, "
            "or use it all the same: failed_calibration = true in the bench file",
        )


def check_made_for(file: CalibrationFile, config: BenchConfig, path: str) -> None:
    """Refuse a calibration of another robot.

    Args:
        file: the calibration.
        config: bench that wants to use it.
        path: where it lies, for the message.

    Raises:
        ConfigError: nominal geometry or servos differ from the bench's, with everything that differs.
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
