"""The emulated propellers behind VESCs: each a controller and a motor of its own, which push together."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from hil.config.thrust import Thrust
from hil.config.thrust_vesc import VescThrustConfig
from hil.fakes.body_interface import HoldingForces
from hil.fakes.can_channel import CanChannel
from hil.fakes.motor_controllers.forces_on_robot import Load
from hil.fakes.motor_controllers.motor_controller import FAN_FAULTS
from hil.fakes.motor_controllers.true_parameters import MotorTruthOptions, Poles, Speed
from hil.fakes.motor_controllers.vesc_node import VescNode
from hil.fakes.world import World
from hil.faults.fault import Supported

PROPELLER_FAULTS: Supported = {kind: opts for kind, opts in FAN_FAULTS.items() if kind != "adhesion_loss"}


@dataclass(frozen=True)
class VescThrustTruthOptions(MotorTruthOptions):
    """Imperfections as of the fan's VESC; ratings that are left out are those of `[thrust]`.

    Attributes:
        rated_input_a: battery current of each controller at full speed.
        rpm_per_v: true speed of the motors per volt, unloaded.
        pole_pairs: true number of the motors; below 0 for controllers that count backwards.
        full_force_n, full_rpm: true force of all propellers together, and the speed at which they give it.
    """

    spin_up_s: float = 0.1
    spin_down_s: float = 0.3
    rated_input_a: float = 10.0
    rpm_per_v: float | None = None
    pole_pairs: Poles | None = None
    full_force_n: Thrust | None = None
    full_rpm: Speed | None = None
    RATINGS: ClassVar[Mapping[str, str]] = {
        "rated_input_a": "rated_input_a",
        "rpm_per_v": "rpm_per_v",
        "pole_pairs": "pole_pairs",
        "rated_force_n": "full_force_n",
        "rated_rpm": "full_rpm",
    }


class PropellerNode(VescNode):
    """One controller with its propellers."""

    Options = VescThrustTruthOptions
    supported_faults = PROPELLER_FAULTS


def propellers(
    world: World, channel: CanChannel, config: VescThrustConfig, options: VescThrustTruthOptions
) -> tuple[PropellerNode, ...]:
    """All controllers of a robot, on its bus."""
    point = world.plant.working_point or HoldingForces(0.0, 0.0)
    count = len(config.controller_ids)
    load = Load(point.thrust_n, point.propeller_gain, world.plant.set_thrust, motors=count)
    motors = config.motors()
    return tuple(
        PropellerNode(world, channel, motor, options, "thrust", load=load, motor=number)
        for number, motor in enumerate(motors)
    )
