"""Versions of one `calibration.toml`: new ones beside the old ones, one of them in place.

A bench names one file. All its versions are stored beside it (`calibration.v1.toml`, ...). A new version is
stored there first. Only after it has passed its validation is it copied into place, atomically. Any version
can be put back.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hil.calibration.calibration_file import (
    CalibrationFile,
    calibration_file,
    keep,
    kept_path,
    next_version,
    read_calibration,
    save_calibration,
)
from hil.calibration.usability_check import check_made_for, check_passed, made_for
from hil.config.bench import BenchConfig
from hil.config.robot_record.parts import Identity
from hil.core.errors import ConfigError, reason_of
from hil.core.result_names import PASSED
from hil.support.atomic_files import put_whole
from hil.support.file_reading import MOST_TOML_BYTES, read_bytes

if TYPE_CHECKING:
    from hil.calibration.calibrate import Calibration


@dataclass(frozen=True)
class KeptVersion:
    """One version: its file, its content, and whether it is the version in place."""

    path: Path
    file: CalibrationFile
    in_place: bool


class CalibrationVersions:
    """All versions of a calibration file.

    Args:
        path: the file that benches name; need not exist yet.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def versions(self) -> tuple[KeptVersion, ...]:
        """Every version, oldest first; raises `ConfigError` for a damaged file."""
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
        """Store a calibration under the next version number; the file in place stays."""
        version = next_version(self.path)
        previous = keep(self.path) if self.path.exists() else {}
        numbered = file.model_copy(update={"version": version, "previous": previous})
        target = kept_path(self.path, version)
        save_calibration(target, numbered)
        return KeptVersion(target, numbered, in_place=False)

    def apply(self, version: int, config: BenchConfig | None = None) -> KeptVersion:
        """Put a version in place, if its validation passed.

        Args:
            version: number of the version.
            config: bench that will use it, None to skip the check against the bench.

        Raises:
            ConfigError: no such version, its validation did not pass, or it belongs to another robot.
        """
        chosen = self.find(version)
        check_passed(chosen.file, str(chosen.path))
        return self._put_in_place(chosen, config)

    def adopt(self, file: CalibrationFile, where: str, config: BenchConfig | None = None) -> KeptVersion:
        """Store a calibration from elsewhere and put it in place; a refused one leaves no file.

        Args:
            file: the calibration.
            where: path of the calibration, for messages.
            config: bench that will use it, None to skip the check against the bench.

        Raises:
            ConfigError: its validation did not pass, it belongs to another robot, or it cannot be written.
        """
        check_passed(file, where)
        if config is not None:
            check_made_for(file, config, where)
        return self.apply(self.add(file).file.version, config)

    def rollback(self, version: int | None = None, config: BenchConfig | None = None) -> KeptVersion:
        """Put an earlier version back: the given one, else the one before the version in place.

        Raises:
            ConfigError: there is no such version, or it belongs to another robot.
        """
        if version is None:
            here = [v.file.version for v in self.versions() if v.in_place]
            earlier = [v.file.version for v in self.versions() if here and v.file.version < here[0]]
            if not earlier:
                raise ConfigError(f"{self.path}: no earlier version to go back to", expected=self._known())
            version = earlier[-1]
        return self._put_in_place(self.find(version), config)

    def find(self, version: int) -> KeptVersion:
        """The version with that number; raises a `ConfigError` that lists the numbers."""
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
            put_whole(self.path.resolve(), chosen.path.read_bytes())
        except OSError as error:
            raise ConfigError(f"{self.path}: cannot be written ({reason_of(error)})") from None
        return KeptVersion(chosen.path, chosen.file, in_place=True)


def store_version(
    path: Path,
    result: Calibration,
    *,
    created: str,
    software: dict[str, str],
    verdict: str,
    config: BenchConfig,
    robot: Identity,
) -> KeptVersion:
    """Store a calibration beside `path`, and put it in place if its validation passed.

    Args:
        path: the calibration in use, `calibration.toml`.
        result: calibration to store.
        created: date and time, ISO 8601.
        software: package versions by package name.
        verdict: verdict of its validation run.
        config: bench that it was made on.
        robot: robot that it belongs to.
    """
    versions = CalibrationVersions(path)
    kept = versions.add(
        calibration_file(
            result,
            created=created,
            software=software,
            verdict=verdict,
            made_for=made_for(config),
            robot=robot,
        )
    )
    return versions.apply(kept.file.version, config) if verdict in PASSED else kept
