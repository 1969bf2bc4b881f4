"""What presses the robot on its surface: a ducted fan."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.config.adhesion import AdhesionConfig
from hil.config.robot import RobotConfig
from hil.devices.adhesion.dronecan import DRONECAN
from hil.devices.adhesion.look import look
from hil.devices.adhesion.vesc import VESC
from hil.vocabulary.kinds import DeviceKind, Figures, Force, Plot, Topic
from hil.vocabulary.signals import AdhesionSample, Inputs, Status

if TYPE_CHECKING:
    from hil.recording.ros_types import MessageMaker

__all__ = ["KIND", "fan_state"]

_RAD_S_PER_RPM = 2.0 * math.pi / 60.0


def fan_state(sample: AdhesionSample, ros: MessageMaker) -> Any:
    """`sensor_msgs/JointState` of the fan; effort holds the motor's current in A."""
    velocity = (sample.speed_rpm * _RAD_S_PER_RPM,)
    return ros.joints(sample.stamp.t_ns, ("fan",), velocity=velocity, effort=(sample.motor_a,))


def _figures(inputs: Inputs) -> Iterator[tuple[str, Figures]]:
    if inputs.adhesion:
        sample = inputs.adhesion[-1]
        yield "adhesion/speed_rpm", {"fan": sample.speed_rpm}
        yield "adhesion/current_a", {"motor": sample.motor_a, "battery": sample.input_a}
        yield "adhesion/battery_v", {"battery": sample.input_v}
        yield "adhesion/temperature_c", {"power stage": sample.fet_c, "motor": sample.motor_c}


def _forces(inputs: Inputs, robot: RobotConfig, own: AdhesionConfig | None) -> Iterator[Force]:
    """What a fan of this speed presses with; a speed that is not known tells nothing."""
    for sample in inputs.adhesion[-1:]:
        if own is not None and sample.status is Status.OK and math.isfinite(sample.speed_rpm):
            yield Force("fan", np.zeros(3), np.array([0.0, 0.0, -own.force_at_n(sample.speed_rpm)]))


KIND = DeviceKind(
    name="adhesion",
    noun="fan",
    sample=AdhesionSample,
    models=(VESC, DRONECAN),
    actuates=True,
    holds=True,
    aliases=("fan",),
    stale_s=lambda safety, own: safety.adhesion_stale_s,
    rate_hz=lambda own, loop_hz: math.nan,
    age_s=0.01,
    gap_s=0.2,
    delivered=0.9,
    topics=(Topic("/adhesion/fan", "sensor_msgs/msg/JointState", fan_state),),
    figures=_figures,
    forces=_forces,
    plots=(
        Plot("Adhesion", "Fan (1/min)", "adhesion/speed_rpm"),
        Plot("Adhesion", "Fan's currents (A)", "adhesion/current_a"),
        Plot("Adhesion", "Fan's battery (V)", "adhesion/battery_v"),
        Plot("Adhesion", "Fan's temperatures (C)", "adhesion/temperature_c"),
    ),
    look=look,
    passes={
        "slow": "reports come less often, and often enough for `safety.adhesion_stale_s`",
        "delayed": "reports of a moment ago say the same of a fan that turns steadily",
    },
)
