"""Tracks what a passed procedure depends on: keys of the bench file, and its parts in the robot's record.

A resumed commissioning repeats a procedure if one of its dependencies has changed: people edit the bench file
between a failure and the next attempt, and restore older versions of the record.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hil.commission.stages import Stage
from hil.config.bench import BenchConfig
from hil.config.robot_record import Part, RobotRecord
from hil.config.robot_record.parts import digest_of
from hil.config.unchecked import changed_since
from hil.core.registry import kinds
from hil.procedure.bench_source import BenchSource
from hil.support.file_reading import get_dotted

_WITH_EVERY_SENSOR = ("latency", "surface_identification", "sensor_noise", "wall_ablation")
_OF_A_SENSOR: Mapping[str, tuple[str, ...]] = {
    "imu": ("bring_up", "imu_calibration", *_WITH_EVERY_SENSOR),
    "tracker": ("bring_up", "tracker_extrinsics", *_WITH_EVERY_SENSOR),
}
"""Procedures that depend on a device. All depend on servos, encoders, motion capture, and non-device keys."""
_NOTHING_RESTS_ON = ("monitor", "record")
_NAMED = 3


def as_its_file_says(source: BenchSource) -> BenchConfig:
    """Return the configuration of a bench without the values from the robot's record."""
    return source.changed(overrides={"record.folder": None}).config


def parts_in(record: Path) -> Mapping[str, Part]:
    """Return the parts of the current version; none without a record. Raises `ConfigError` if damaged."""
    robot = RobotRecord(record)
    return robot.read().parts if robot.exists() else {}


def dependencies_of(
    config: BenchConfig, parts: Mapping[str, Part], left: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Return the dependencies of a passed procedure to store, as JSON values.

    Args:
        config: configuration of the bench file alone.
        parts: current parts of the record.
        left: `record` of the run's result, which names the parts that the run wrote; None for none.
    """
    names = () if left is None else left["parts"]
    return {
        "bench": config.model_dump(mode="json", by_alias=True),
        "parts": {name: _digest(parts[name]) for name in names if name in parts},
    }


def reason_to_repeat(
    stage: Stage, before: Mapping[str, Any], config: BenchConfig, parts: Mapping[str, Part]
) -> str:
    """Return why a passed procedure has to be repeated; empty if none of its dependencies has changed.

    Args:
        stage: the passed procedure.
        before: result of `dependencies_of` at that time.
        config: current configuration of the bench file alone.
        parts: current parts of the record.
    """
    return "; ".join(
        (*_of_the_record(before["parts"], parts), *_of_the_bench(stage, before["bench"], config))
    )


def _of_the_record(left: Mapping[str, str], parts: Mapping[str, Part]) -> Iterator[str]:
    for name, digest in left.items():
        if name not in parts:
            yield f"its part {name} is no longer in the record"
        elif _digest(parts[name]) != digest:
            yield f"the part {name} in the record, of {parts[name].measured}, is another than it had left"


def _of_the_bench(stage: Stage, then: Mapping[str, Any], config: BenchConfig) -> Iterator[str]:
    now = config.model_dump(mode="json", by_alias=True)
    changed = [key for key in changed_since(then, config) if _matters(stage, key)]
    if changed:
        reported = [
            f"{key} ({get_dotted(then, key)!r} then, {get_dotted(now, key)!r} now)"
            for key in changed[:_NAMED]
        ]
        more = f" and {len(changed) - _NAMED} more" if len(changed) > _NAMED else ""
        yield f"the bench file has changed in {', '.join(reported)}{more}"


def _matters(stage: Stage, key: str) -> bool:
    """Whether a procedure depends on a key of the bench file; `[emulation.KIND]` counts as that device."""
    table = key.removeprefix("emulation.").split(".")[0]
    kind = kinds().get(table)
    if kind is not None and (kind.holds_robot or kind.guards_hold):
        return stage.place == "wall"  # on the floor neither fan nor propellers run
    return table not in _NOTHING_RESTS_ON and stage.name in _OF_A_SENSOR.get(table, (stage.name,))


def _digest(part: Part) -> str:
    return digest_of(part.model_dump(mode="json"))
