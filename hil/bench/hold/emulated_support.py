"""The messages of `hil emulate` on a wall: the robot is held by hand until a client enables torque.

From then on it slides without torque, as a real robot does.
"""

import math

import numpy as np

from hil.bench.hold.held_state import Held, seen_in_words
from hil.config.bench import BenchConfig
from hil.fakes.body_interface import PlantState
from hil.fakes.plant.common_body import SteppedBody
from hil.fakes.world import World

_RESTS_M_S = 0.001
_FAR_M = 10.0


class EmulatedSupport:
    """Uses the true state of the emulated robot, not the commands of clients.

    Args:
        config: the bench configuration.
        world: the robot's world.
        servos: True if the servos are served, so that a client can enable them.
    """

    def __init__(self, config: BenchConfig, world: World, servos: bool) -> None:
        self._world, self._servos = world, servos
        self._can_slide = config.environment.on_wall and isinstance(world.plant, SteppedBody)
        self._first = self._truth().pose_body_in_wall.copy()

    def at_the_start(self) -> str:
        """Message at the start; empty if the robot cannot slide. Servos have no torque after power-on."""
        if not self._can_slide:
            return ""
        until = "let go when a client enables torque; without torque it slides from then on"
        if not self._servos:
            until = "not let go, because no servos are served"
        why = f"the robot is on its wall and no servo has torque; it is held by hand and {until}"
        return "at the start " + seen_in_words(Held("NOT HELD", None, why))

    def at_the_end(self) -> str:
        """Message at the end: whether the robot rests on its wall, and its displacement; or empty."""
        if not self._can_slide:
            return ""
        truth = self._truth()
        speed_m_s = math.hypot(*truth.twist_body[:2])
        moved_m = float(np.hypot(*(truth.pose_body_in_wall - self._first)[:2]))
        far = f"{1e3 * moved_m:.0f} mm" if moved_m < _FAR_M else f"{moved_m:.0f} m"
        message = f"{far} from where it began"
        if getattr(self._world.plant, "by_hand", False):
            held = Held("NOT HELD", moved_m, "no client has enabled torque; the robot was held by hand")
        elif truth.fallen:
            held = Held("NOT HELD", moved_m, f"the robot has left its wall, {message}")
        elif speed_m_s > _RESTS_M_S:
            held = Held("NOT HELD", moved_m, f"the robot slides at {1e3 * speed_m_s:.0f} mm/s, {message}")
        else:
            held = Held("HELD", moved_m, f"the robot rests on its wall, {message}")
        return "at the end " + seen_in_words(held)

    def _truth(self) -> PlantState:
        self._world.sync_plant()
        return self._world.plant.truth()
