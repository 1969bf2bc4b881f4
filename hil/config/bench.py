"""The whole `bench.toml`: its model, how it is found, read, overridden and checked.

Strict: unknown keys are errors, and every problem is reported at once with its dotted path.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from hil.config.control import ControlConfig
from hil.config.encoders import EncodersConfig
from hil.config.estimator import EstimatorConfig
from hil.config.imu import ImuConfig
from hil.config.mocap import MocapConfig
from hil.config.robot import RobotConfig
from hil.config.servos import ServosConfig
from hil.config.tracker import TrackerConfig
from hil.errors import ConfigError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_PATHS = ("calibration", "imu.calibration_file", "encoders.dbc", "emulation.replay")
DEVICES = ("servos", "encoders", "imu", "tracker", "mocap")


class Strict(BaseModel):
    """Base of the models here: unknown keys rejected, values frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


class LoopConfig(Strict):
    """Rate and real-time behaviour of the control loop.

    Attributes:
        rate_hz: cycles per second.
        late_after_s: a cycle that starts later than this after its deadline counts as late.
        fifo_priority: priority under SCHED_FIFO, where the system allows it; none leaves the scheduler alone.
        cpu: number of the core that the loop is bound to; none leaves it to the system.
    """

    rate_hz: float = Field(100.0, gt=0, le=1000)
    late_after_s: float = Field(0.001, gt=0)
    fifo_priority: int | None = Field(None, ge=1, le=99)
    cpu: int | None = Field(None, ge=0)


class SafetyConfig(Strict):
    """When the supervisor stops the robot, and where it may be sent.

    Attributes:
        servo_stale_s, imu_stale_s, tracker_stale_s: age after which a device counts as silent.
        wheel_rate_limit_rad_s, steering_limit_rad: setpoints are clipped to these.
        heading_limit_rad: on a wall; beyond it the thrust no longer points up.
        tracking_error_limit_m: distance from the reference.
        body_speed_limit_m_s: speed that the camera may see: faster is a slide.
        adhesion_limit_m_s2: specific force below which the robot counts as falling.
        x_range_m, y_range_m: usable surface; references that leave it are refused.
    """

    servo_stale_s: float = Field(0.1, gt=0)
    imu_stale_s: float = Field(0.5, gt=0)
    tracker_stale_s: float = Field(2.0, gt=0)
    wheel_rate_limit_rad_s: float = Field(4.9, gt=0)
    steering_limit_rad: float = Field(2.0944, gt=0)
    heading_limit_rad: float = Field(0.2618, gt=0)
    tracking_error_limit_m: float = Field(0.5, gt=0)
    body_speed_limit_m_s: float = Field(0.5, gt=0)
    adhesion_limit_m_s2: float = Field(5.0, ge=0, lt=9.8)
    x_range_m: tuple[float, float] | None = None
    y_range_m: tuple[float, float] | None = None


class AlignmentConfig(Strict):
    """Signs and zeros between servo angles and body angles, wheel order FL, BL, BR, FR.

    Attributes:
        drive_sign, steer_sign: 1, or -1 where the servo is mounted the other way round.
        steer_zero_rad: servo angle at which the wheel points along body x (`procedures/steering_zero.py`).
    """

    drive_sign: tuple[int, int, int, int] = (1, 1, 1, 1)
    steer_sign: tuple[int, int, int, int] = (1, 1, 1, 1)
    steer_zero_rad: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _signs(self) -> AlignmentConfig:
        for name in ("drive_sign", "steer_sign"):
            if any(s not in (-1, 1) for s in getattr(self, name)):
                raise ValueError(f"{name} must hold only 1 and -1")
        return self


class EmulationConfig(Strict):
    """The emulated world: only read when at least one device is emulated.

    Attributes:
        surface: what the robot stands on: `floor`, `concrete`, `melamine` or `patchy`.
        tilt_rad: of the surface: 0 floor, pi/2 wall.
        start_pose: (x m, y m, theta rad) in the wall frame.
        faults: specs (`imu:stuck@2+3`) or paths of TOML timelines.
        randomise_truth: draw the robot's true parameters by seed instead of taking the nominal ones.
        geometry_share: share of the drawn deviations of wheel positions, radii and steering zeros; 1 is the
            robot as delivered, less is what a calibration would have left of them.
        replay: recording (of this project, a public pair, or plain CSV) whose motion the robot repeats,
            whatever it is commanded; without it the robot is simulated.
        replay_after_s: world time at which that motion begins; before it the robot stands.
        servos, encoders, imu, tracker, mocap: true imperfections of the emulated devices, by the names
            in `ServoBusOptions`, `EncoderTruthOptions`, `ImuTruthOptions`, `TrackerTruthOptions` and
            `MocapTruthOptions` of `hil.fakes`.
    """

    surface: str = "melamine"
    tilt_rad: float = Field(1.5707963267948966, ge=0.0, le=3.15)
    start_pose: tuple[float, float, float] = (0.0, 0.0, 0.0)
    randomise_truth: bool = True
    geometry_share: float = Field(1.0, ge=0.0, le=1.0)
    faults: tuple[str, ...] = ()
    replay: str | None = None
    replay_after_s: float = Field(4.0, ge=0.0)
    servos: dict[str, Any] = {}
    encoders: dict[str, Any] = {}
    imu: dict[str, Any] = {}
    tracker: dict[str, Any] = {}
    mocap: dict[str, Any] = {}


class ExitConfig(Strict):
    """What happens to the robot when the work ends.

    Attributes:
        policy: `hold` keeps torque on, `release` drops it: on a wall the robot then slides.
    """

    policy: Literal["hold", "release"] = "hold"


class BenchConfig(Strict):
    """Everything about one bench. A missing device section means that the bench lacks the device.

    Attributes:
        schema: version of this format: 1.
        name: of the bench, in every result and recording.
        surface: `wall` (gravity in the plane of motion, heading guarded) or `floor`.
        calibration: path of the `calibration.toml` to apply; nominal geometry without one. Like every
            path in the file, a relative one starts at the file's folder.
    """

    schema_version: Literal[1] = Field(alias="schema")
    name: str = Field(min_length=1)
    surface: Literal["wall", "floor"] = "wall"
    calibration: str | None = None
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
    folder = resources.files("hil.profiles")
    return tuple(sorted(p.name[:-5] for p in folder.iterdir() if p.name.endswith(".toml")))


def find_bench(source: str | Path) -> tuple[str, str]:
    """Text and printable origin of a bench file: a path, or the name of a shipped profile."""
    path = Path(source)
    if path.suffix == ".toml" or path.exists():
        try:
            return path.read_text(encoding="utf-8"), str(path)
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(
                f"{path}: cannot be read ({error})", remedy="give a bench.toml or a profile name"
            ) from None
    if str(source) in profile_names():
        return (
            resources.files("hil.profiles").joinpath(f"{source}.toml").read_text(encoding="utf-8"),
            f"profile {source}",
        )
    raise ConfigError(
        f"bench {str(source)!r} is neither a file nor a shipped profile",
        expected="a path to a .toml file or one of " + ", ".join(profile_names()),
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
        text, origin = find_bench(source)
        try:
            tree = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise ConfigError(f"{origin}: not valid TOML ({error})") from None
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
            )
    return names


def validate(tree: Mapping[str, Any], origin: str) -> BenchConfig:
    """Model of a parsed file; raises `ConfigError` with all problems."""
    try:
        return BenchConfig.model_validate(tree)
    except ValidationError as error:
        problems = tuple(
            f"{'.'.join(str(part) for part in item['loc']) or 'file'}: {_reason(item)}"
            for item in error.errors()
        )
    raise ConfigError(f"{origin}: {len(problems)} problem(s)", problems=problems)


def _reason(item: Any) -> str:
    if item["type"] == "extra_forbidden":
        return "unknown key; remove it or check the spelling"
    if item["type"] == "missing":
        return "missing"
    return f"{item['msg']} (found {item['input']!r})"
