"""Motion capture: the pose of the robot's rigid body, seen from outside."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from hil.core.device import DeviceKind, Topic
from hil.core.finding import Finding
from hil.core.geometry import Array
from hil.core.signals import MocapSample, Status
from hil.devices.doctor_watch import Watched
from hil.devices.mocap.doctor_check import look
from hil.devices.mocap.natnet_model import NatNet

if TYPE_CHECKING:
    from hil.recording.ros_types import MessageMaker

__all__ = ["KIND"]

_OK = Status.OK


def _pose(sample: MocapSample, ros: MessageMaker) -> Any:
    """`geometry_msgs/PoseStamped` in the capture frame."""
    return ros.pose_stamped(sample.stamp.t_ns, "mocap", sample.position_m, sample.quaternion_wxyz)


class Mocap(DeviceKind):
    """The pose of a rigid body, seen from outside."""

    name, noun, sample = "mocap", "motion capture", MocapSample
    models = (NatNet(),)
    max_age_s, max_gap_s, min_delivered = 0.05, 0.5, 0.8
    has_own_clock = True
    topics = (Topic("/mocap/pose", "geometry_msgs/msg/PoseStamped", _pose),)
    motion_threshold, measures_position = 0.0005, True
    silent_faults: ClassVar[Mapping[str, str]] = {
        "intermittent": "the stream is judged second by second: told within two seconds of a longer run",
        "delayed": "the stream is judged second by second: told within two seconds of a longer run",
    }

    def rate_hz(self, config: Any, loop_hz: float) -> float:
        """NaN: the capture system sets it."""
        return math.nan

    def motion_value(self, sample: MocapSample) -> Array | None:
        """Position (3,) in m."""
        return sample.position_m if sample.status is _OK and sample.tracking_valid else None

    def check(self, watched: Watched) -> Iterator[Finding]:
        """Tracked frames, gaps, latency."""
        return look(watched)


KIND = Mocap()
