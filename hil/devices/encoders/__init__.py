"""External encoders on the four steering axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hil.devices.encoders.as5045 import AS5045
from hil.devices.encoders.look import look
from hil.vocabulary.kinds import DeviceKind, Topic
from hil.vocabulary.signals import SERVOS, WHEELS, EncoderSample

if TYPE_CHECKING:
    from hil.recording.ros_types import MessageMaker

__all__ = ["KIND", "encoder_state"]


def encoder_state(sample: EncoderSample, ros: MessageMaker) -> Any:
    """`sensor_msgs/JointState` of the external encoders' own angles, NaN where one cannot be used."""
    return ros.joints(sample.stamp.t_ns, SERVOS[4:], position=sample.angle_rad)


KIND = DeviceKind(
    name="encoders",
    noun="steering encoders",
    sample=EncoderSample,
    models=(AS5045,),
    aliases=("can",),
    endpoint="can",
    labels=WHEELS,
    rate_hz=lambda own, loop_hz: float(own.rate_hz),
    age_s=0.01,
    gap_s=0.05,
    delivered=0.98,
    own_clock=True,
    topics=(Topic("/steering_encoders", "sensor_msgs/msg/JointState", encoder_state),),
    look=look,
)
