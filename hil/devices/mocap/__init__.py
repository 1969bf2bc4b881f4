"""Motion capture: the pose of the robot's rigid body, seen from outside."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from hil.devices.mocap.look import look
from hil.devices.mocap.natnet import NATNET
from hil.vocabulary.geometry import Array
from hil.vocabulary.kinds import DeviceKind, Topic, Witness
from hil.vocabulary.signals import MocapSample, Status

if TYPE_CHECKING:
    from hil.recording.ros_types import MessageMaker

__all__ = ["KIND"]

_OK = Status.OK


def _pose(sample: MocapSample, ros: MessageMaker) -> Any:
    """`geometry_msgs/PoseStamped` in the capture frame."""
    return ros.pose_stamped(sample.stamp.t_ns, "mocap", sample.position_m, sample.quaternion_wxyz)


def _place(sample: MocapSample) -> Array | None:
    return sample.position_m if sample.status is _OK and sample.tracking_valid else None


KIND = DeviceKind(
    name="mocap",
    noun="motion capture",
    sample=MocapSample,
    models=(NATNET,),
    rate_hz=lambda own, loop_hz: math.nan,
    age_s=0.05,
    gap_s=0.5,
    delivered=0.8,
    own_clock=True,
    topics=(Topic("/mocap/pose", "geometry_msgs/msg/PoseStamped", _pose),),
    witness=Witness(still=0.0005, value=_place, is_place=True),
    look=look,
    passes={
        "intermittent": "the stream is judged second by second: told within two seconds of a longer run",
        "delayed": "the stream is judged second by second: told within two seconds of a longer run",
    },
)
