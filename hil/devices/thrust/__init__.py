"""What carries part of the robot's weight: propellers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hil.devices.looks import samples_look
from hil.devices.thrust.teensy import TEENSY
from hil.recording.cdr import joints
from hil.vocabulary.kinds import DeviceKind, Figures, Plot, Topic
from hil.vocabulary.signals import Inputs, ThrustSample

__all__ = ["KIND", "propeller_state"]

_NOTHING = np.empty(0)


def propeller_state(sample: ThrustSample, wall_ns: int = 0) -> bytes:
    """`sensor_msgs/JointState`; the position holds the throttle 0..1."""
    values = (np.array([sample.throttle]), _NOTHING, _NOTHING)
    return joints(sample.stamp.t_ns, ("propellers",), values, wall_ns)


def _figures(inputs: Inputs) -> Iterator[tuple[str, Figures]]:
    if inputs.thrust:
        yield "adhesion/throttle", {"propellers": inputs.thrust[-1].throttle}


KIND = DeviceKind(
    name="thrust",
    noun="propellers",
    sample=ThrustSample,
    models=(TEENSY,),
    actuates=True,
    holds=True,
    aliases=("propellers",),
    rate_hz=lambda own, loop_hz: 1.0 / float(getattr(own, "repeat_s", 0.1)),
    age_s=0.005,
    gap_s=0.5,
    topics=(Topic("/adhesion/propellers", "sensor_msgs/msg/JointState", propeller_state),),
    figures=_figures,
    plots=(Plot("Adhesion", "Propellers' throttle", "adhesion/throttle"),),
    look=samples_look("check cable and supply of the propellers' Teensy"),
)
