"""External encoders on the four steering axes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from hil.core.device import DeviceKind, Topic
from hil.core.finding import Finding
from hil.core.signals import SERVOS, WHEELS, EncoderSample
from hil.devices.doctor_watch import Watched
from hil.devices.encoders.as5045_model import As5045
from hil.devices.encoders.doctor_check import look

if TYPE_CHECKING:
    from hil.recording.ros_types import MessageMaker

__all__ = ["KIND", "encoder_state"]


def encoder_state(sample: EncoderSample, ros: MessageMaker) -> Any:
    """`sensor_msgs/JointState` of the external encoders' own angles, NaN where one cannot be used."""
    return ros.joints(sample.stamp.t_ns, SERVOS[4:], position=sample.angle_rad)


class Encoders(DeviceKind):
    """Angles of the steering axes, apart from the servos' own."""

    name, noun, sample = "encoders", "steering encoders", EncoderSample
    models, aliases, endpoint, labels = (As5045(),), ("can",), "can", WHEELS
    max_age_s, max_gap_s, min_delivered = 0.01, 0.05, 0.98
    has_own_clock = True
    topics = (Topic("/steering_encoders", "sensor_msgs/msg/JointState", encoder_state),)

    def check(self, watched: Watched) -> Iterator[Finding]:
        """CAN link, node, and each axis."""
        return look(watched)


KIND = Encoders()
