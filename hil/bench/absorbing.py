"""Older files into the record of a robot: a calibration, a piece of a bench file, a part, another record."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hil.calibration.artefact import CalibrationFile, read_calibration
from hil.calibration.versions import PASSED, check_made_for
from hil.config.bench import BenchConfig
from hil.config.loading import explained
from hil.config.record import PARTS, NewPart, Part, RobotRecord
from hil.config.record.folder import check_robot
from hil.config.record.overlay import identity
from hil.config.record.parts import part_of
from hil.vocabulary.errors import ConfigError
from hil.vocabulary.reading import dotted, read_toml

_FILES = ("imu.calibration_file", "calibration")


def absorb(record: RobotRecord, source: Path, config: BenchConfig, now: str) -> tuple[str, ...]:
    """Take the parts that a file or another record holds, as a new version.

    Args:
        record: that takes them.
        source: `part_NAME.toml`, `calibration.toml`, `bench_fragment.toml`, or the folder of a record.
        config: bench of the robot that they belong to.
        now: date and time, ISO 8601.

    Returns:
        Names of the parts that had to go.

    Raises:
        ConfigError: it is none of these, did not pass its validation, or is of another robot.
    """
    parts = (
        _of_record(RobotRecord(source), record, config) if source.is_dir() else _of_file(source, config, now)
    )
    return record.add(parts, identity(config), created=now, why=f"{source.name} was applied")


def _of_record(other: RobotRecord, record: RobotRecord, config: BenchConfig) -> dict[str, NewPart]:
    file = other.read()
    check_robot(file, identity(config), other.path)
    if record.path.exists():
        check_robot(file, record.read().robot, other.path)
    return {
        name: NewPart(part.model_copy(update={"files": {}, "made_with": {}}),
                      {key: other.path_of(part, key) for key in part.files})
        for name, part in file.parts.items()
    }  # fmt: skip


def _of_file(path: Path, config: BenchConfig, now: str) -> dict[str, NewPart]:
    tree = read_toml(path)
    if "part" in tree:
        return _of_part(path, tree)
    if "twist_correction" in tree:
        return {"geometry": _of_calibration(path, read_calibration(path), config)}
    return _of_fragment(path, tree, config, now)


def _of_part(path: Path, tree: dict[str, Any]) -> dict[str, NewPart]:
    name = tree.pop("part")
    try:
        part = Part.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(f"{path}: no part of a record", problems=tuple(explained(error))) from None
    if name not in PARTS:
        raise ConfigError(f"{path}: {name!r} is no part", expected="one of " + ", ".join(PARTS))
    files = {key: path.parent / str(part.values[key]) for key in _FILES if key in part.values}
    values = {key: value for key, value in part.values.items() if key not in files}
    return {name: NewPart(part.model_copy(update={"values": values}), files)}


def _of_calibration(path: Path, file: CalibrationFile, config: BenchConfig) -> NewPart:
    if file.verdict not in PASSED:
        raise ConfigError(
            f"{path}: has not passed a validation run (verdict {file.verdict or 'none'})",
            remedy="calibrate with `hil run odometry_calibration`, which ends in one",
        )
    check_made_for(file, config, str(path))
    verdict = "MARGINAL" if file.verdict == "MARGINAL" else "PASS"
    part = Part(procedure="odometry_calibration", verdict=verdict, measured=file.created, bench=config.name)
    return NewPart(part, {"calibration": path})


def _of_fragment(path: Path, tree: Mapping[str, Any], config: BenchConfig, now: str) -> dict[str, NewPart]:
    """Keys of a piece of a bench file, each to the part that may hold it."""
    found: dict[str, dict[str, Any]] = {}
    files: dict[str, dict[str, Path]] = {}
    unknown = []
    for key, value in dotted(tree):
        name = part_of(key)
        if name is None:
            unknown.append(f"{key}: no part of a record holds it; it belongs into the bench file")
        elif key in _FILES:
            found.setdefault(name, {})
            files.setdefault(name, {})[key] = path.parent / str(value)
        else:
            found.setdefault(name, {})[key] = value
    if unknown or not found:
        raise ConfigError(f"{path}: nothing of it was applied", problems=tuple(unknown),
                          expected="what a procedure left as bench_fragment.toml")  # fmt: skip
    return {
        name: NewPart(
            Part(
                procedure=PARTS[name].measured_by,
                verdict="PASS",
                measured=now,
                bench=config.name,
                values=values,
            ),
            files.get(name, {}),
        )
        for name, values in found.items()
    }
