"""The whole `bench.toml`: its model, how it is found, read, overridden and checked.

Strict: unknown keys are errors, and every problem is reported at once with its dotted path.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Literal, get_args

from pydantic import BaseModel, Field, ValidationError

from hil.config.consistency import contradictions
from hil.config.control import ControlConfig
from hil.config.encoders import EncodersConfig
from hil.config.environment import EnvironmentConfig
from hil.config.estimator import EstimatorConfig
from hil.config.imu import ImuConfig
from hil.config.mocap import MocapConfig
from hil.config.older import lifted, told_where_now
from hil.config.robot import RobotConfig
from hil.config.sections import (
    AlignmentConfig,
    EmulationConfig,
    ExitConfig,
    LoopConfig,
    SafetyConfig,
    Strict,
)
from hil.config.servos import ServosConfig
from hil.config.tracker import TrackerConfig
from hil.vocabulary.errors import ConfigError, did_you_mean
from hil.vocabulary.reading import read_toml, toml_tables

_PATHS = ("calibration", "imu.calibration_file", "encoders.dbc", "emulation.replay")
DEVICES = ("servos", "encoders", "imu", "tracker", "mocap")


class BenchConfig(Strict):
    """Everything about one bench. A missing device section means that the bench lacks the device.

    Attributes:
        schema: version of this format: 1.
        name: of the bench, in every result and recording.
        calibration: path of the `calibration.toml` to apply; nominal geometry without one. Like every
            path in the file, a relative one starts at the file's folder.
    """

    schema_version: Literal[1] = Field(alias="schema")
    name: str = Field(min_length=1)
    calibration: str | None = None
    environment: EnvironmentConfig = EnvironmentConfig()
    loop: LoopConfig = LoopConfig()
    safety: SafetyConfig = SafetyConfig()
    alignment: AlignmentConfig = AlignmentConfig()
    emulation: EmulationConfig = EmulationConfig()
    exit: ExitConfig = ExitConfig()
    robot: RobotConfig = RobotConfig()
    control: ControlConfig = ControlConfig()
    estimator: EstimatorConfig = EstimatorConfig()
    servos: ServosConfig | None = None
    encoders: EncodersConfig | None = None
    imu: ImuConfig | None = None
    tracker: TrackerConfig | None = None
    mocap: MocapConfig | None = None

    def devices(self) -> dict[str, Any]:
        """Configured devices by name, in the fixed order."""
        return {n: getattr(self, n) for n in DEVICES if getattr(self, n) is not None}

    def emulated(self) -> tuple[str, ...]:
        """Names of the devices whose backend is emulated."""
        return tuple(n for n, c in self.devices().items() if c.backend == "emulated")

    @property
    def placed(self) -> bool:
        """Whether `environment.start_pose` is where the robot stands: an emulated one, or it is written so.

        A bench without servos has no robot that could be elsewhere.
        """
        emulated = self.servos is None or self.servos.backend == "emulated"
        return emulated or "start_pose" in self.environment.model_fields_set

    @property
    def knows_start(self) -> bool:
        """Whether it is `placed` or real motion capture sees it; emulated cameras see no real robot."""
        return self.placed or (self.mocap is not None and self.mocap.backend == "real")

    def must_know_start(self) -> None:
        """Refuse a real robot of which nobody knows where it stands; raises `ConfigError`."""
        if not self.knows_start:
            raise ConfigError(
                f"{self.name}: nobody knows where the robot stands: it is real and no motion capture sees it",
                expected="its start pose (x m, y m, theta rad in the wall frame)",
                remedy="give --start x,y,theta (start_pose in Python), or write [environment] start_pose",
            )

    def settled(self, *, realtime: bool) -> BenchConfig:
        """With what depends on how the bench runs decided: `servos.prefetch`, where the file leaves it out.

        Args:
            realtime: the bench is asked to run in real time; one with a real device does in any case.
        """
        if self.servos is None:
            return self
        at_the_wire = realtime or len(self.emulated()) < len(self.devices())
        ahead = self.servos.asks_ahead(realtime=at_the_wire, rate_hz=self.loop.rate_hz)
        return self.model_copy(update={"servos": self.servos.model_copy(update={"prefetch": ahead})})


def profile_names() -> tuple[str, ...]:
    """Names of the shipped profiles."""
    folder = resources.files("hil.config.profiles")
    return tuple(sorted(p.name[:-5] for p in folder.iterdir() if p.name.endswith(".toml")))


def find_bench(source: str | Path) -> tuple[dict[str, Any], str]:
    """Tables and printable origin of a bench file: a path, or the name of a shipped profile."""
    path = Path(source)
    if path.suffix == ".toml" or path.exists():
        return read_toml(path, remedy="give a bench.toml or a profile name"), str(path)
    if str(source) in profile_names():
        origin = f"profile {source}"
        text = resources.files("hil.config.profiles").joinpath(f"{source}.toml").read_text(encoding="utf-8")
        return toml_tables(text, origin), origin
    raise ConfigError(
        f"bench {str(source)!r} is neither a file nor a shipped profile",
        expected="a path to a .toml file or one of " + ", ".join(profile_names()),
        remedy=did_you_mean(str(source), profile_names()),
    )


def _overlay(tree: dict[str, Any], dotted: str, value: object) -> None:
    *path, leaf = dotted.split(".")
    for key in path:
        nested = tree.setdefault(key, {})
        if not isinstance(nested, dict):
            raise ConfigError(f"override {dotted}: {key} is a value, not a table")
        tree = nested
    tree[leaf] = value


def load_bench(
    source: str | Path | BenchConfig = "emulated",
    *,
    emulate: str | tuple[str, ...] | None = None,
    overrides: Mapping[str, object] | None = None,
) -> BenchConfig:
    """Read and check a bench configuration.

    Args:
        source: path, profile name, or a model that is already built.
        emulate: `all` or device names whose backend is switched to emulated.
        overrides: dotted key -> value, applied before validation.

    Raises:
        ConfigError: listing every problem with its dotted path.
    """
    if isinstance(source, BenchConfig):
        tree, origin = source.model_dump(by_alias=True, exclude_unset=True), source.name
    else:
        tree, origin = find_bench(source)
        if origin == str(source):
            _anchor(tree, Path(source).parent)
    for dotted, value in (overrides or {}).items():
        _overlay(tree, dotted, value)
    _anchor(tree, Path.cwd())
    for name in _to_emulate(tree, emulate):
        tree[name]["backend"] = "emulated"
    return validate(tree, origin)


def _anchor(tree: dict[str, Any], folder: Path) -> None:
    """Make relative paths absolute: those of a bench file start at its folder, others at the current one."""
    for dotted in _PATHS:
        *tables, key = dotted.split(".")
        table: Any = tree
        for name in tables:
            table = table.get(name) if isinstance(table, dict) else None
        if isinstance(table, dict) and isinstance(table.get(key), str):
            table[key] = str(folder / table[key])


def _to_emulate(tree: Mapping[str, Any], emulate: str | tuple[str, ...] | None) -> tuple[str, ...]:
    if emulate is None:
        return ()
    names = tuple(emulate.split(",")) if isinstance(emulate, str) else emulate
    present = tuple(n for n in DEVICES if isinstance(tree.get(n), dict))
    if names == ("all",):
        return present
    for name in names:
        if name not in present:
            raise ConfigError(
                f"--emulate {name}: the bench has no such device",
                expected="all or some of " + ", ".join(present),
                remedy=did_you_mean(name, present),
            )
    return names


def validate(tree: Mapping[str, Any], origin: str) -> BenchConfig:
    """Model of a parsed file; raises `ConfigError` with all problems."""
    problems = list(told_where_now(tree))
    present = lifted(tree)
    config: BenchConfig | None
    try:
        config = BenchConfig.model_validate(present)
    except ValidationError as error:
        problems += explained(error)
        config = _what_is_right(present, [item["loc"] for item in error.errors()])
    if config is not None:
        problems += [f"{path}: {text}" for path, text in contradictions(config)]
        if not problems:
            return config
    raise ConfigError(f"{origin}: {len(problems)} problem(s)", problems=tuple(problems))


def _what_is_right(tree: dict[str, Any], wrong: list[tuple[int | str, ...]]) -> BenchConfig | None:
    """The configuration without its wrong values, to look at the others; None if nothing is left of it."""
    rest = copy.deepcopy(tree)
    for *tables, key in wrong:
        table: Any = rest
        for name in tables:
            inner = table.get(name) if isinstance(table, dict) else None
            if not isinstance(inner, dict):
                key = name
                break
            table = inner
        if isinstance(table, dict):
            table.pop(key, None)
    try:
        return BenchConfig.model_validate(rest)
    except ValidationError:
        return None


def explained(error: ValidationError) -> list[str]:
    """Every problem of an error: its dotted path, and what is wrong there."""
    return [
        f"{'.'.join(str(part) for part in item['loc']) or 'file'}: {_reason(item)}" for item in error.errors()
    ]


def _keys(tables: Sequence[int | str]) -> tuple[str, ...]:
    """Names of the keys in a table of the file, given by the names on the way to it."""
    model: Any = BenchConfig
    for name in tables:
        field = model.model_fields.get(name) if isinstance(name, str) else None
        kinds = () if field is None else (field.annotation, *get_args(field.annotation))
        model = next((k for k in kinds if isinstance(k, type) and issubclass(k, BaseModel)), None)
        if model is None:
            return ()
    return tuple(field.alias or name for name, field in model.model_fields.items())


def _reason(item: Any) -> str:
    if item["type"] == "extra_forbidden":
        *tables, key = item["loc"]
        near = did_you_mean(str(key), _keys(tables))
        return f"unknown key; {near or 'remove it or check the spelling'}"
    if item["type"] == "missing":
        return "missing"
    return f"{item['msg']} (found {item['input']!r})"
