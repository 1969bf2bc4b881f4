"""What carries part of the robot's weight: propellers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from hil.config.robot import RobotConfig
from hil.config.thrust import ThrustConfig
from hil.devices.looks import samples_look
from hil.devices.thrust.teensy import TEENSY
from hil.devices.thrust.vesc import VESC_THRUST
from hil.vocabulary.kinds import DeviceKind, Figures, Force, Plot, Topic
from hil.vocabulary.signals import Inputs, Status, ThrustSample

if TYPE_CHECKING:
    from hil.recording.ros_types import MessageMaker

__all__ = ["KIND", "propeller_state"]


def propeller_state(sample: ThrustSample, ros: MessageMaker) -> Any:
    """`sensor_msgs/JointState`; the position holds the throttle 0..1."""
    return ros.joints(sample.stamp.t_ns, ("propellers",), position=(sample.throttle,))


def _figures(inputs: Inputs) -> Iterator[tuple[str, Figures]]:
    if inputs.thrust:
        yield "adhesion/throttle", {"propellers": inputs.thrust[-1].throttle}


def _forces(inputs: Inputs, robot: RobotConfig, own: ThrustConfig | None) -> Iterator[Force]:
    """What the propellers give at the throttle that was sent last; one that is not known tells nothing."""
    for sample in inputs.thrust[-1:]:
        if own is not None and sample.status is Status.OK and math.isfinite(sample.throttle):
            yield from itertools.starmap(Force, robot.propellers(own.force_at_n(sample.throttle)))


KIND = DeviceKind(
    name="thrust",
    noun="propellers",
    sample=ThrustSample,
    models=(TEENSY, VESC_THRUST),
    actuates=True,
    holds=True,
    aliases=("propellers",),
    rate_hz=lambda own, loop_hz: 1.0 / float(getattr(own, "repeat_s", math.nan)),
    age_s=0.005,
    gap_s=0.5,
    topics=(Topic("/adhesion/propellers", "sensor_msgs/msg/JointState", propeller_state),),
    figures=_figures,
    forces=_forces,
    plots=(Plot("Adhesion", "Propellers' throttle", "adhesion/throttle"),),
    look=samples_look("check cable and supply of the propellers' controllers"),
    passes={"*": "this controller sends nothing back"},
)
