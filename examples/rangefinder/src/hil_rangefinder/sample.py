"""What a range finder delivers, and the ROS 2 message that it becomes in a recording."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hil.recording.cdr import CdrWriter
from hil.vocabulary.signals import Stamp, Status

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


def range_message(sample: RangeSample, wall_ns: int = 0) -> bytes:
    """`sensor_msgs/Range`; NaN for a distance that cannot be used, as REP 117 asks."""
    cdr = CdrWriter(wall_ns)
    cdr.header(sample.stamp.t_ns, "rangefinder")
    cdr.u8(_INFRARED)
    cdr.f32(sample.field_of_view_rad)
    cdr.f32(sample.least_m)
    cdr.f32(sample.most_m)
    cdr.f32(sample.distance_m if sample.status is Status.OK else math.nan)
    return cdr.bytes()
