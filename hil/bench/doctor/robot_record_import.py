"""Imports calibrations, bench-file fragments, parts or another record into a robot's record."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hil.calibration.calibration_file import CalibrationFile, read_calibration
from hil.calibration.usability_check import check_made_for, check_passed
from hil.config.bench import BenchConfig
from hil.config.loading import explained, load_bench
from hil.config.robot_record import PARTS, NewPart, Part, RobotRecord
from hil.config.robot_record.folder import check_robot
from hil.config.robot_record.limits import implausible
from hil.config.robot_record.origin import Origin, of_fragment, of_part
from hil.config.robot_record.overlay import identity
from hil.config.robot_record.parts import Identity, part_of
from hil.core.errors import ConfigError
from hil.core.registry import kinds
from hil.support.file_reading import dotted, read_toml

_FILES = ("imu.calibration_file", "calibration")


@dataclass(frozen=True)
class _Found:
    """Parts that a file contains, and their origin."""

    parts: dict[str, NewPart]
    origin: Origin


def import_record(
    record: RobotRecord, source: Path, config: BenchConfig, now: str, *, of_this_robot: bool = False
) -> tuple[str, ...]:
    """Import the parts of a file or of another record, as a new version.

    Args:
        record: record that receives the parts.
        source: `part_NAME.toml`, `calibration.toml`, `bench_fragment.toml`, or the folder of a record.
        config: bench configuration of the robot that they belong to.
        now: date and time, ISO 8601.
        of_this_robot: True if the user confirms the robot of a file that does not name its robot.

    Returns:
        Names of the removed parts.

    Raises:
        ConfigError: the source is none of these, belongs to another robot or names none, comes from a run
            that did not pass, or contains values that are impossible for this robot.
    """
    robot = identity(config)
    if source.is_dir():
        parts = _of_record(RobotRecord(source), record, robot)
    else:
        found = _of_file(source, config, now)
        for one in (robot, record.read().robot) if record.exists() else (robot,):
            found.origin.must_be_of(one, source, of_this_robot=of_this_robot)
        parts = found.parts
        if robot.body is None and found.origin.robot is not None:
            robot = robot.model_copy(update={"body": found.origin.robot.body})
    for part in parts.values():
        _check_values(source, part.part.values, config)
    return record.add(parts, robot, created=now, why=f"{source.name} was applied")


def _of_record(other: RobotRecord, record: RobotRecord, robot: Identity) -> dict[str, NewPart]:
    file = other.read()
    check_robot(file, robot, other.path)
    if record.path.exists():
        check_robot(file, record.read().robot, other.path)
    return {
        name: NewPart(
            part.model_copy(update={"files": {}, "made_with": {}}),
            {key: other.path_of(part, key) for key in part.files},
        )
        for name, part in file.parts.items()
    }


def _of_file(path: Path, config: BenchConfig, now: str) -> _Found:
    tree = read_toml(path)
    if "part" in tree:
        return _of_part(path, tree)
    if "twist_correction" in tree:
        return _of_calibration(path, read_calibration(path), config)
    return _of_fragment(path, tree, config, now)


def _check_values(path: Path, values: Mapping[str, Any], config: BenchConfig) -> None:
    """Raise `ConfigError` with all values that a procedure or a bench file would refuse."""
    problems = list(implausible({key: value for key, value in values.items() if key not in _FILES}))
    if not problems:
        present = config.devices()
        given = {
            key: value
            for key, value in values.items()
            if key not in _FILES and ((table := key.split(".")[0]) in present or table not in kinds())
        }
        try:
            load_bench(config, overrides=given)
        except ConfigError as error:
            problems = list(error.problems) or [error.message]
    if problems:
        raise ConfigError(
            f"{path}: {len(problems)} value(s) that this robot cannot have; nothing of it was applied",
            problems=tuple(problems),
            remedy="measure it again",
        )


def _of_part(path: Path, tree: dict[str, Any]) -> _Found:
    origin, name = of_part(path, tree), tree.pop("part")
    if name not in list(PARTS):
        raise ConfigError(f"{path}: {name!r} is no part", expected="one of " + ", ".join(PARTS))
    origin.must_have_passed(path)
    tree.pop("robot", None)
    try:
        part = Part.model_validate({**tree, "verdict": origin.verdict})
    except ValidationError as error:
        raise ConfigError(f"{path}: no part of a record", problems=tuple(explained(error))) from None
    strangers = tuple(
        f"{key}: belongs to {part_of(key) or 'no part'}" for key in part.values if part_of(key) != name
    )
    if strangers:
        raise ConfigError(f"{path}: not a part {name}; nothing of it was applied", problems=strangers)
    files = {key: path.parent / str(part.values[key]) for key in _FILES if key in part.values}
    values = {key: value for key, value in part.values.items() if key not in files}
    return _Found({name: NewPart(part.model_copy(update={"values": values}), files)}, origin)


def _of_calibration(path: Path, file: CalibrationFile, config: BenchConfig) -> _Found:
    check_passed(file, str(path))
    check_made_for(file, config, str(path))
    verdict = "MARGINAL" if file.verdict == "MARGINAL" else "PASS"
    part = Part(procedure="odometry_calibration", verdict=verdict, measured=file.created, bench=config.name)
    return _Found(
        {"geometry": NewPart(part, {"calibration": path})}, Origin(file.robot, verdict, part.procedure)
    )


def _of_fragment(path: Path, tree: Mapping[str, Any], config: BenchConfig, now: str) -> _Found:
    """Convert a bench-file fragment to parts of a record, by the keys that each part may hold."""
    origin = of_fragment(path)
    origin.must_have_passed(path)
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
        raise ConfigError(
            f"{path}: nothing of it was applied",
            problems=tuple(unknown),
            expected="what a procedure left as bench_fragment.toml",
        )
    facts = {"procedure": origin.procedure, "verdict": origin.verdict, "measured": now, "bench": config.name}
    try:
        parts = {
            name: NewPart(Part.model_validate({**facts, "values": values}), files.get(name, {}))
            for name, values in found.items()
        }
    except ValidationError as error:
        raise ConfigError(f"{path}: nothing of it was applied", problems=tuple(explained(error))) from None
    return _Found(parts, origin)
