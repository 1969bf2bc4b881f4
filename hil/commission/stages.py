"""The order of a commissioning: its procedures, the place of the robot and the bench for each.

Each procedure builds on the earlier ones: signs before zeros, zeros before wheels, wheels before slip. The
floor comes first, because circles are possible there and the robot does not creep.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from hil.config.bench import BenchConfig
from hil.config.imu import Bno055Config
from hil.core.registry import kinds
from hil.procedure.declaration import Procedure
from hil.procedure.procedure_lookup import load_procedure

Place = Literal["floor", "wall"]
_FLOOR: dict[str, object] = {
    "environment.surface": "floor",
    "environment.tilt_rad": 0.0,
    "environment.x_range_m": None,
    "environment.y_range_m": None,
    "environment.friction": None,
}
PROMPTS: Mapping[Place, str] = {
    "floor": "set the robot on the floor, 2 m free around it and in view of motion capture, then press Enter",
    "wall": "put the robot on its wall, on a tether, at its start pose, then press Enter",
}


@dataclass(frozen=True)
class Stage:
    """One procedure of a commissioning.

    Attributes:
        name: name of the procedure.
        place: place of the robot.
        weight: approximate computing time of the quick form, s; to estimate the time left.
        full: parameters that differ in the long form.
    """

    name: str
    place: Place
    weight: float
    full: Mapping[str, Any] = field(default_factory=dict)

    @property
    def procedure(self) -> Procedure:
        """The declaration of the procedure."""
        return load_procedure(self.name)

    def parameters(self, quick: bool) -> dict[str, Any]:
        """Return the parameters of the quick or the long form."""
        return dict(self.procedure.quick if quick else self.full)

    def lacking(self, config: BenchConfig) -> str:
        """Return why the stage has to be left out on a bench; empty if it can run."""
        missing = [n for n in self.procedure.needs if n not in config.devices()]
        if missing:
            return f"the bench has no {', '.join(missing)}"
        if self.name == "imu_calibration" and config.of(Bno055Config) is None:
            return "this IMU keeps no offsets for a client to store"
        return ""


STAGES = (
    Stage("bring_up", "floor", 8.0),
    Stage("steering_zero", "floor", 8.0),
    Stage("odometry_calibration", "floor", 45.0, {"repetitions": 3, "max_rounds": 3, "compared_methods": ()}),
    Stage("tracker_extrinsics", "floor", 12.0, {"repetitions": 3, "way_m": 0.8}),
    Stage("adhesion_check", "wall", 5.0),
    Stage("imu_calibration", "wall", 10.0),
    Stage("latency", "wall", 6.0),
    Stage("surface_identification", "wall", 14.0, {"hold": False, "repetitions": 4}),
    Stage("sensor_noise", "wall", 10.0, {"repetitions": 2}),
    Stage("wall_ablation", "wall", 30.0),
)


def stages(config: BenchConfig, order: Sequence[Stage]) -> Iterator[tuple[Stage, str]]:
    """Yield every stage, and why it is left out on this bench (empty if it runs).

    A floor bench has no wall; its robot is verified by odometry alone.

    Args:
        config: configuration of the bench.
        order: all stages.
    """
    for stage in order:
        why = stage.lacking(config)
        if not why and stage.place == "wall" and not config.environment.on_wall:
            why = "the bench stands on the floor"
        yield stage, why


def off_the_wall(config: BenchConfig) -> dict[str, object]:
    """Return overrides of a wall bench for a robot on floor or stand: neither fan nor propellers run."""
    if not config.environment.on_wall:
        return {}
    return _FLOOR | {name: None for name, kind in kinds().items() if kind.holds_robot or kind.guards_hold}


def placed(stage: Stage, number: int, config: BenchConfig) -> dict[str, object]:
    """Return bench overrides of a stage: its place, and a separate session for an emulated camera.

    Args:
        stage: stage to run.
        number: number of the stage.
        config: configuration of the wall bench.
    """
    overrides: dict[str, object] = {}
    if stage.place == "floor":
        overrides |= off_the_wall(config)
    if config.imperfections("tracker").get("session_scale_sigma"):
        overrides["emulation.tracker.session"] = number
    return overrides
