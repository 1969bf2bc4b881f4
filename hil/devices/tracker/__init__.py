"""Tracking cameras: the pose since they began, by visual-inertial odometry."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hil.devices.tracker.look import look
from hil.devices.tracker.mavlink import MAVLINK
from hil.devices.tracker.t265 import T265
from hil.vocabulary.geometry import Array
from hil.vocabulary.kinds import DeviceKind, Topic, Witness
from hil.vocabulary.signals import Status, TrackerSample

if TYPE_CHECKING:
    from hil.recording.ros_types import MessageMaker

__all__ = ["KIND"]

_OK = Status.OK


def _pose(sample: TrackerSample, ros: MessageMaker) -> Any:
    """`geometry_msgs/PoseStamped` in the camera's start frame."""
    t_ns = sample.stamp.t_ns
    return ros.pose_stamped(t_ns, "tracker_start", sample.position_m, sample.quaternion_wxyz)


def _place(sample: TrackerSample) -> Array | None:
    return sample.position_m if sample.status is _OK else None


KIND = DeviceKind(
    name="tracker",
    noun="camera",
    sample=TrackerSample,
    models=(T265, MAVLINK),
    stale_s=lambda safety, own: safety.tracker_stale_s,
    rate_hz=lambda own, loop_hz: float(getattr(own, "rate_hz", 200.0)),
    age_s=0.05,
    gap_s=0.1,
    delivered=0.95,
    own_clock=True,
    topics=(Topic("/tracker/pose", "geometry_msgs/msg/PoseStamped", _pose),),
    witness=Witness(still=0.001, value=_place, is_place=True),  # m: noise of 0.5 mm leaves 0.1 in the mean
    look=look,
)
