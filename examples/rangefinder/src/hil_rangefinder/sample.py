"""What a range finder delivers, and the ROS 2 message that it becomes in a recording."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hil.vocabulary.signals import Stamp, Status

if TYPE_CHECKING:
    from hil.recording.ros_types import MessageMaker

_INFRARED = 1


@dataclass(frozen=True)
class RangeSample:
    """One measured distance.

    Attributes:
        stamp: when it was measured.
        distance_m: from the sensor along its beam; NaN unless `status` is OK.
        strength: of the echo, in the sensor's own counts; 0 where nothing was received.
        temperature_c: of the sensor; NaN where nothing was received.
        least_m, most_m: between which the model can measure.
        field_of_view_rad: opening angle of the beam.
        status: why the distance can or cannot be used. `low confidence`: the echo is too weak or too strong;
            `implausible`: nearer or farther than the model can measure.
    """

    stamp: Stamp
    distance_m: float
    strength: int
    temperature_c: float
    least_m: float
    most_m: float
    field_of_view_rad: float
    status: Status = Status.OK


def range_message(sample: RangeSample, ros: MessageMaker) -> Any:
    """`sensor_msgs/Range`; NaN for a distance that cannot be used, as REP 117 asks."""
    return ros.message(
        "sensor_msgs/msg/Range",
        header=ros.header(sample.stamp.t_ns, "rangefinder"),
        radiation_type=_INFRARED,
        field_of_view=sample.field_of_view_rad,
        min_range=sample.least_m,
        max_range=sample.most_m,
        range=sample.distance_m if sample.status is Status.OK else math.nan,
    )
