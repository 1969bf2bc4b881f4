"""The kind `rangefinder`: distance from the robot to what stands in the way of one beam.

This is what the bench knows of the kind. Its only model is in `tf_luna.py`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hil.vocabulary.geometry import Array
from hil.vocabulary.kinds import DeviceKind, Figures, Plot, Topic, Witness
from hil.vocabulary.signals import Inputs, Status
from hil_rangefinder.look import look
from hil_rangefinder.sample import RangeSample, range_message
from hil_rangefinder.tf_luna import TF_LUNA

__all__ = ["KIND", "RangeSample"]


def _figures(inputs: Inputs) -> Iterator[tuple[str, Figures]]:
    samples = inputs.of("rangefinder")
    if samples:
        newest: RangeSample = samples[-1]
        yield "rangefinder/distance_m", {"distance": newest.distance_m}
        if not math.isnan(newest.temperature_c):
            yield "rangefinder/strength", {"strength": float(newest.strength)}


def _distance(sample: RangeSample) -> Array | None:
    """The plate is above the robot, so that its distance shows a slide."""
    return np.array([sample.distance_m]) if sample.status is Status.OK else None


KIND = DeviceKind(
    name="rangefinder",
    noun="range finder",
    sample=RangeSample,
    models=(TF_LUNA,),
    aliases=("lidar",),
    stale_s=lambda safety, own: float(own.stale_s),
    rate_hz=lambda own, loop_hz: float(own.rate_hz),
    age_s=0.02,
    gap_s=0.1,
    delivered=0.95,
    topics=(Topic("/range", "sensor_msgs/msg/Range", range_message),),
    figures=_figures,
    plots=(
        Plot("Range", "Distance to the plate (m)", "rangefinder/distance_m"),
        Plot("Range", "Signal strength", "rangefinder/strength"),
    ),
    witness=Witness(still=0.008, value=_distance, is_place=True),  # m: four times what noise of 3 mm leaves
    look=look,
)
