"""One robot in every world, and the few things that one does with a robot without its bench."""

from __future__ import annotations

from typing import Any

import numpy as np

from hil.config.robot import RobotConfig
from hil.core.clock import NS_PER_S
from hil.core.geometry import Array
from hil.fakes.body_interface import JointCommand
from hil.fakes.plant import SteppedBody, make_plant
from hil.fakes.plant.mujoco import make_mujoco_plant
from hil.fakes.world import random_stream

WORLDS = ("own", "creep", "holding")
TITLES = {"own": "own plant", "creep": "MuJoCo, rolling creep", "holding": "MuJoCo, holding contact"}
PERIOD_NS = 10_000_000
FLOOR: dict[str, Any] = {"surface": "floor", "tilt_rad": 0.0}


def robot(
    world: str, seed: int = 0, *, drawn: bool = False, config: RobotConfig | None = None, **options: Any
) -> SteppedBody:
    """The robot of a seed in a world; nominal unless `drawn`."""
    options |= {"rng": random_stream(seed, "plant"), "randomise_truth": drawn}
    if world == "own":
        return make_plant(config or RobotConfig(), **options)
    return make_mujoco_plant(config or RobotConfig(), contact=world, **options)


def wait(plant: SteppedBody, duration_s: float) -> None:
    """Let time pass."""
    plant.advance(plant.t_ns + round(duration_s * NS_PER_S))


def turn(plant: SteppedBody, rates_rad_s: Array | float, angles_rad: Array | float) -> None:
    """Wheel rates and steering angles to the joints."""
    rates, angles = np.broadcast_to(rates_rad_s, 4), np.broadcast_to(angles_rad, 4)
    for i in range(4):
        plant.command(i, JointCommand("velocity", float(rates[i])))
        plant.command(i + 4, JointCommand("position", float(angles[i])))


def stand(plant: SteppedBody, angles_rad: Array | float = 0.0, duration_s: float = 1.0) -> None:
    """Hold still with the steering turned."""
    turn(plant, 0.0, angles_rad)
    wait(plant, duration_s)
