"""The whole `bench.toml` as a model: its tables, and those of the devices that the registry knows."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, reduce
from operator import or_
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Discriminator, Field, Tag, ValidationError, create_model

from hil.config.bench_sections import (
    AlignmentConfig,
    EmulationConfig,
    ExitConfig,
    FaultsConfig,
    LoopConfig,
    RecordConfig,
    SafetyConfig,
)
from hil.config.control import ControlConfig
from hil.config.device import DeviceConfig
from hil.config.environment import EnvironmentConfig
from hil.config.estimator import EstimatorConfig
from hil.config.field_types import Strict, Switch
from hil.config.mocap import MocapConfig
from hil.config.monitor import MonitorConfig
from hil.config.robot import RobotConfig
from hil.config.ros2 import Ros2Config
from hil.config.servos import ServosConfig
from hil.core.device import DeviceKind, DeviceModel
from hil.core.errors import ConfigError
from hil.core.registry import added, base_of, kinds

C = TypeVar("C", bound=DeviceConfig)


class BenchConfig(Strict):
    """Configuration of one bench; each device has a further table, named after its kind.

    A missing table means that the bench lacks the device. `bench_model` gives the model with these tables.

    Attributes:
        schema: version of this format: 1.
        name: label of the bench in every result and recording.
        calibration: path of the `calibration.toml` to apply; nominal geometry without one. Like every
            path in the file, a relative one starts at the file's folder.
        failed_calibration: true to use a calibration also where its validation run ended in FAIL.
    """

    schema_version: Literal[1] = Field(alias="schema")
    name: str = Field(min_length=1)
    calibration: str | None = None
    failed_calibration: Switch = False
    environment: EnvironmentConfig = EnvironmentConfig()
    loop: LoopConfig = LoopConfig()
    safety: SafetyConfig = SafetyConfig()
    alignment: AlignmentConfig = AlignmentConfig()
    emulation: EmulationConfig = EmulationConfig()
    faults: FaultsConfig = FaultsConfig()
    record: RecordConfig = RecordConfig()
    exit: ExitConfig = ExitConfig()
    robot: RobotConfig = RobotConfig()
    control: ControlConfig = ControlConfig()
    estimator: EstimatorConfig = EstimatorConfig()
    monitor: MonitorConfig = MonitorConfig()
    ros2: Ros2Config = Ros2Config()

    def devices(self) -> dict[str, DeviceConfig]:
        """Configured devices by name, in the fixed order: further ones of a kind after the one named so."""
        tables = ((name, getattr(self, name)) for name in type(self).model_fields)
        return {name: table for name, table in tables if isinstance(table, DeviceConfig)}

    def of(self, kind: type[C]) -> C | None:
        """The table of the device that has this type (`config.of(ServosConfig)`); None without it.

        Of several of a kind the bench's own is meant.
        """
        own = (getattr(self, name, None) for name in kinds())
        return next((table for table in own if isinstance(table, kind)), None)

    def labels(self) -> dict[str, str | None]:
        """`name` of each device in the bench file, by its name on the bench."""
        return {name: table.name for name, table in self.devices().items()}

    def imperfections(self, kind: str) -> dict[str, Any]:
        """The table `[emulation.KIND]` of the bench file; empty without one."""
        found: dict[str, Any] = getattr(self.emulation, kind, {})
        return found

    def emulated(self) -> tuple[str, ...]:
        """Names of the devices whose backend is emulated."""
        return tuple(n for n, c in self.devices().items() if c.backend == "emulated")

    def elsewhere(self) -> tuple[str, ...]:
        """Names of the devices that are in another world than the servos: they cannot measure their robot.

        Emulated ones beside real servos, real ones beside emulated servos; none on a bench without servos.
        """
        servos = self.of(ServosConfig)
        if servos is None:
            return ()
        return tuple(name for name, one in self.devices().items() if one.backend != servos.backend)

    def emulated_holders(self) -> tuple[str, ...]:
        """Names of emulated devices that should hold a robot with real servos on its wall, but cannot."""
        servos = self.of(ServosConfig)
        if servos is None or servos.backend != "real":
            return ()
        return tuple(name for name in self.elsewhere() if kinds()[name].holds_robot)

    def force_sensor_elsewhere(self) -> str:
        """Which of fan and load cells is not in the servos' world, where only one of the two is; else empty.

        Its force is that of another robot, so the two are not compared, and the other one alone counts.
        """
        pair = {name for name in ("adhesion", "load_cells") if name in self.devices()}
        apart = pair.intersection(self.elsewhere())
        return apart.pop() if len(pair) == 2 and len(apart) == 1 else ""

    def of_one_world(self) -> BenchConfig:
        """The same bench without the devices that are `elsewhere`: all that see the servos' robot."""
        others = self.elsewhere()
        return self.model_copy(update=dict.fromkeys(others)) if others else self

    @property
    def placed(self) -> bool:
        """Whether the robot stands at `environment.start_pose`: it is emulated, or the file gives the pose.

        A bench without servos has no robot that could be elsewhere.
        """
        servos = self.of(ServosConfig)
        emulated = servos is None or servos.backend == "emulated"
        return emulated or "start_pose" in self.environment.model_fields_set

    @property
    def knows_start(self) -> bool:
        """Whether it is `placed` or real motion capture sees it; emulated cameras see no real robot."""
        capture = self.of(MocapConfig)
        return self.placed or (capture is not None and capture.backend == "real")

    def must_know_start(self) -> None:
        """Refuse a real robot whose start pose is unknown; raises `ConfigError`."""
        if not self.knows_start:
            raise ConfigError(
                f"{self.name}: the start pose is unknown: the robot is real and no motion capture sees it",
                expected="its start pose (x m, y m, theta rad in the wall frame)",
                remedy="give --start x,y,theta (start_pose in Python), or write [environment] start_pose",
            )

    def settled(self, *, realtime: bool) -> BenchConfig:
        """The configuration with `servos.prefetch` decided by how the bench runs, if the file leaves it out.

        Args:
            realtime: True if the bench is asked to run in real time; one with a real device does in any case.
        """
        servos = self.of(ServosConfig)
        if servos is None:
            return self
        at_the_wire = realtime or len(self.emulated()) < len(self.devices())
        ahead = servos.asks_ahead(realtime=at_the_wire, rate_hz=self.loop.rate_hz)
        return self.model_copy(update={"servos": servos.model_copy(update={"prefetch": ahead})})


@cache
def bench_model(further: tuple[str, ...] = ()) -> type[BenchConfig]:
    """`BenchConfig` with a table for every kind of device, and one of imperfections in `[emulation]`.

    Args:
        further: names of further devices, which have such tables, too.

    Raises:
        ConfigError: an installed package adds a device that cannot be used.
    """
    _check_added()
    names = [n for kind in kinds() for n in (kind, *(f for f in further if base_of(f) == kind))]
    imperfections: dict[str, Any] = {name: (dict[str, Any], {}) for name in names}
    emulation = create_model("EmulationConfig", __base__=EmulationConfig, **imperfections)
    emulation.__doc__ = EmulationConfig.__doc__
    tables: dict[str, Any] = {name: (table_of(kinds()[name]) | None, None) for name in names}
    model = create_model("BenchConfig", __base__=BenchConfig, emulation=(emulation, emulation()), **tables)
    model.__doc__ = BenchConfig.__doc__
    return model


def _check_added() -> None:
    """Check what other packages add: names that the bench file does not use, tables of the right class."""
    ours = {*BenchConfig.model_fields, *EmulationConfig.model_fields}
    for kind in added():
        if kind.name in ours or hasattr(BenchConfig, kind.name):
            raise ConfigError(
                f"device package {kind.package}: {kind.name} is the name of another part of the bench file",
                remedy="give the kind another name",
            )
    for model in (m for kind in kinds().values() for m in kind.models):
        if not issubclass(model.config, DeviceConfig):
            raise ConfigError(
                f"device package {model.package}: the table of model {model.name} of {model.kind} is a "
                f"{model.config.__name__}",
                expected="a class that inherits hil.config.device.DeviceConfig",
            )
        if model.config.model_fields["name"].annotation != DeviceConfig.model_fields["name"].annotation:
            raise ConfigError(
                f"device package {model.package}: the table of model {model.name} of {model.kind} has a key "
                "`name` of its own, which says which of several devices of a kind it is",
                remedy="call the key otherwise",
            )
        if model.package != "hil":
            _check_defaults(model)


def _check_defaults(model: DeviceModel) -> None:
    """Refuse a table whose defaults could not stand in a bench file: pydantic only looks at what is given."""
    table: type[DeviceConfig] = model.config
    defaults = {
        name: field.get_default(call_default_factory=True)
        for name, field in table.model_fields.items()
        if not field.is_required() and field.default_factory is None
    }
    try:
        table.model_validate(defaults)
    except ValidationError as error:
        wrong = [
            f"{'.'.join(map(str, e['loc']))} = {e['input']!r}: {e['msg']}"
            for e in error.errors()
            if e["loc"] and e["type"] != "missing"
        ]
        if wrong:
            raise ConfigError(
                f"device package {model.package}: wrong defaults in the table {table.__name__} of model "
                f"{model.name} of {model.kind}: {'; '.join(wrong)}",
                expected="defaults of the types and within the bounds that their keys state",
            ) from None


def table_of(kind: DeviceKind) -> Any:
    """Type of a kind's table: that of the model that it names, or of the kind's first model."""
    if len(kind.models) == 1:
        return kind.models[0].config
    default = kind.models[0].name

    def chosen(value: Any) -> Any:
        return value.get("model", default) if isinstance(value, Mapping) else getattr(value, "model", default)

    tagged = (Annotated[m.config, Tag(m.name)] for m in kind.models)
    return Annotated[reduce(or_, tagged), Discriminator(chosen)]
