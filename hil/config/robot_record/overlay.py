"""Overlays a bench file with a robot's record: its values override the file's, `--set` both.

Noise is the exception: there the file overrides the record, because a noise that a user writes down
is meant to stay (a preset counts as written down).
"""

from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any

from hil.config.robot_record.folder import RobotRecord, check_robot
from hil.config.robot_record.parts import PARTS, Confirmation, Identity, Part, RecordFile
from hil.core.errors import ConfigError, did_you_mean
from hil.core.registry import kinds
from hil.core.result_names import PASSED
from hil.support.file_reading import get_dotted, put_dotted

_TRUE_MOUNTS = ("mount_position_m", "mount_rotation_wxyz")
"""Keys of a device that also say how an emulated one is truly mounted, unless `[emulation]` does."""


def apply_record(tree: dict[str, Any], overrides: Mapping[str, object], today: date) -> RecordFile | None:
    """Put the values of the record that a bench file or an override names into the parsed file.

    Args:
        tree: parsed bench file, changed in place.
        overrides: dotted key -> value, which go on top later.
        today: date for the validity of parts.

    Returns:
        The record; None where none is named or it is still empty.

    Raises:
        ConfigError: it cannot be used, or a part of it is past its validity or of another surface.
    """
    table = tree.get("record")
    asked = dict(table) if isinstance(table, dict) else {}
    asked.update({k.removeprefix("record."): v for k, v in overrides.items() if k.startswith("record.")})
    folder, without = asked.get("folder"), asked.get("without", ())
    if not isinstance(folder, str):
        return None
    if isinstance(without, str):
        without = tuple(filter(None, without.split(",")))
    record = RobotRecord(Path(folder))
    if not record.exists():
        return None
    file = record.read()
    wall = _is_wall(tree, overrides)
    parts = {
        name: part
        for name, part in file.parts.items()
        if name not in without and (wall or part.surface in ("", "floor"))
    }
    _check_valid(record, parts, _environment(tree, overrides, "surface"), today)
    preset = overrides.get("estimator.preset", get_dotted(tree, "estimator.preset"))
    for name, part in parts.items():
        yields = PARTS[name].yields
        if yields and preset not in (None, "recommended"):
            continue
        for key, value in part.values.items():
            if not (yields and get_dotted(tree, key) is not None):
                _put(tree, key, str(record.path_of(part, key)) if key in part.files else value)
    return file


def _check_valid(record: RobotRecord, parts: Mapping[str, Part], surface: object, today: date) -> None:
    problems = []
    for name, part in parts.items():
        again = f"measure it again: hil run {PARTS[name].measured_by} --set bench.record.without={name}"
        if part.over(today):
            problems.append(f"{name}: of {part.measured[:10]}, valid until {part.until}; {again}")
        if part.surface and part.surface != surface:
            problems.append(f"{name}: measured on {part.surface}, the bench stands on {surface}; {again}")
    if problems:
        raise ConfigError(
            f"{record.path}: {len(problems)} part(s) do not hold here; nothing of the record is applied",
            problems=tuple(problems),
            remedy="or leave them out: [record] without = [...]",
        )


def _environment(tree: Mapping[str, Any], overrides: Mapping[str, object], key: str) -> object:
    from hil.config.environment import EnvironmentConfig

    table = tree.get("environment")
    default = EnvironmentConfig.model_fields[key].default
    value = table.get(key, default) if isinstance(table, Mapping) else default
    return overrides.get(f"environment.{key}", value)


def _is_wall(tree: Mapping[str, Any], overrides: Mapping[str, object]) -> bool:
    from hil.config.environment import FLOOR_TILT_RAD

    tilt = _environment(tree, overrides, "tilt_rad")
    return isinstance(tilt, (int, float)) and tilt > FLOOR_TILT_RAD


def _put(tree: dict[str, Any], dotted: str, value: object) -> None:
    """Put a value into the tree, unless the bench lacks its device. Mounts of emulated devices stay true."""
    *tables, key = dotted.split(".")
    if tables and tables[0] in kinds():
        kind = tables[0]
        table = tree.get(kind)
        if not isinstance(table, dict):
            return
        if key in _TRUE_MOUNTS:
            before = table.get(key, _default(kind, table, key))
            tree.setdefault("emulation", {}).setdefault(kind, {}).setdefault(key, before)
    put_dotted(tree, dotted, value, "record:")


def _default(kind: str, table: Mapping[str, Any], key: str) -> object:
    models = kinds()[kind].models
    model = next((m for m in models if m.name == table.get("model")), models[0])
    return model.config.model_fields[key].default


def known_parts(config: Any) -> dict[str, Part]:
    """Parts of the record that a bench runs with, by name; none without a record."""
    file, without = _record_of(config), config.record.without
    return {} if file is None else {name: part for name, part in file.parts.items() if name not in without}


def _record_of(config: Any) -> RecordFile | None:
    folder = config.record.folder
    if folder is None or not (record := RobotRecord(Path(folder))).exists():
        return None
    return record.read()


def kept_confirmations(config: Any) -> dict[str, Confirmation]:
    """Keys that measurements confirmed, as the record of a bench keeps them; none without a record.

    A value that a procedure has found is confirmed by that procedure.
    """
    file = _record_of(config)
    if file is None:
        return {}
    found = {
        key: Confirmation(value=value, by=part.procedure, procedure=part.procedure, measured=part.measured)
        for name, part in file.parts.items()
        for key, value in part.values.items()
        if name not in config.record.without and part.verdict in PASSED
    }
    return {**found, **{key: one for key, one in file.confirmed.items() if key not in found}}


def identity(config: Any, seed: int | None = None) -> Identity:
    """The identity of the robot of a bench: name, servos, wheels and body.

    Args:
        config: configuration of the bench.
        seed: seed of the emulated world, which draws what an emulated robot is; None where it is not known.
    """
    from hil.config.servos import ServosConfig

    servos, robot = config.of(ServosConfig), config.robot
    return Identity(
        name=robot.name or config.name,
        body=None if servos is None else _body(servos.backend, config.emulation, seed),
        servo_model=None if servos is None else servos.model_number,
        drive_ids=None if servos is None else servos.drive_ids,
        steer_ids=None if servos is None else servos.steer_ids,
        wheel_x_m=robot.wheel_x_m,
        wheel_y_m=robot.wheel_y_m,
        wheel_radius_m=robot.wheel_radius_m,
    )


def _body(backend: str, emulation: Any, seed: int | None) -> str | None:
    if backend == "real":
        return "real"
    if seed is None or emulation.replay is not None:
        return None
    return f"emulated, of seed {seed} in plant {emulation.plant}"


def check_record(file: RecordFile | None, config: Any, seed: int | None) -> None:
    """Refuse the record of another robot, and names in `without` that are no parts; raises `ConfigError`.

    Args:
        file: the version in place; None without a record.
        config: configuration of the bench.
        seed: seed of the emulated world, if known.
    """
    settings = config.record
    unknown = [name for name in settings.without if name not in PARTS]
    if unknown:
        raise ConfigError(
            f"record.without: {', '.join(unknown)}: no such part",
            expected="some of " + ", ".join(PARTS),
            remedy=did_you_mean(unknown[0], PARTS),
        )
    if file is not None:
        check_robot(file, identity(config, seed), RobotRecord(Path(settings.folder)).path)
