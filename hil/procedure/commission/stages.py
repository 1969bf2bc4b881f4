"""The order of a commissioning: which procedure when, where the robot stands for it, and on which bench.

Each builds on those before it: signs before zeros, zeros before wheels, wheels before slip. The floor comes
first, because circles are possible there and nothing creeps.
"""

from __future__ import annotations

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
        name: of the procedure.
        place: where the robot stands for it.
        weight: about how long it takes, in seconds of computing of the quick form; for the time left.
        full: parameters that the long form changes.
    """

    name: str
    place: Place
    weight: float
    full: Mapping[str, Any] = field(default_factory=dict)

    @property
    def procedure(self) -> Procedure:
        """Its declaration."""
        return load_procedure(self.name)

    def parameters(self, quick: bool) -> dict[str, Any]:
        """Parameters of the form asked for."""
        return dict(self.procedure.quick if quick else self.full)

    def lacking(self, config: BenchConfig) -> str:
        """Why it has to be left out on a bench; empty where it can run."""
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
    """Every stage, and why it is left out on this bench (empty where it is not).

    A bench on a floor has no wall; its robot is verified by odometry alone.

    Args:
        config: of the bench.
        order: all stages.
    """
    for stage in order:
        why = stage.lacking(config)
        if not why and stage.place == "wall" and not config.environment.on_wall:
            why = "the bench stands on the floor"
        yield stage, why


def off_the_wall(config: BenchConfig) -> dict[str, object]:
    """Overrides of a wall's bench for a robot on floor or stand: neither fan nor propellers run there."""
    if not config.environment.on_wall:
        return {}
    return _FLOOR | {name: None for name, kind in kinds().items() if kind.holds_robot or kind.guards_hold}


def placed(stage: Stage, number: int, config: BenchConfig) -> dict[str, object]:
    """Bench overrides of a stage: its place, and for an emulated camera a session of its own.

    Args:
        stage: that is to run.
        number: of the stage.
        config: of the wall bench.
    """
    overrides: dict[str, object] = {}
    if stage.place == "floor":
        overrides |= off_the_wall(config)
    if config.imperfections("tracker").get("session_scale_sigma"):
        overrides["emulation.tracker.session"] = number
    return overrides
