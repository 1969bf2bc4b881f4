"""A laser range finder (Benewake TF-Luna): the kind, its sample, its model, and the bench file's table."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from statistics import median, pstdev
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator

from hil import devkit as kit
from hil_rangefinder.protocol import RATES_HZ

LEAST_M, MOST_M, FIELD_OF_VIEW_RAD = 0.2, 8.0, 0.0349
"""Blind zone, range on a white target, 2 degrees (TF-Luna manual, "Ranging Characteristics")."""
_INFRARED, _FAINT = 1, 200


@dataclass(frozen=True)
class RangeSample:
    """One measured distance.

    Attributes:
        stamp: when it was measured.
        distance_m: from the sensor along its beam; NaN unless `status` is OK.
        strength: of the echo, in the sensor's own counts; 0 where nothing was received.
        temperature_c: of the sensor; NaN where nothing was received.
        status: `low confidence`: echo too weak or too strong; `implausible`: out of its range.
    """

    stamp: kit.Stamp
    distance_m: float
    strength: int
    temperature_c: float
    status: kit.Status = kit.Status.OK


def range_message(sample: RangeSample, ros: kit.MessageMaker) -> object:
    """`sensor_msgs/Range`; NaN for a distance that cannot be used, as REP 117 asks."""
    return ros.message(
        "sensor_msgs/msg/Range",
        header=ros.header(sample.stamp.t_ns, "rangefinder"),
        radiation_type=_INFRARED,
        field_of_view=FIELD_OF_VIEW_RAD,
        min_range=LEAST_M,
        max_range=MOST_M,
        range=sample.distance_m,
    )


class TfLunaConfig(kit.SerialSensorConfig, kit.MountedConfig):
    """The table `[rangefinder]`; keys of every serial sensor are described in hil's documentation.

    Attributes:
        rate_hz: distances per second: 500 divided by a whole number, rounded down, at most 250.
        resolution: `cm` as delivered, or `mm`.
        save: whether the sensor keeps its settings in flash memory, which wears: once is enough.
        mount_position_m, mount_rotation_wxyz: the sensor in the body; its beam goes along its own x axis.
        silence_s: after so long without a distance the settings are sent again: its power may have gone.
    """

    model: Literal["tf_luna"] = "tf_luna"
    rate_hz: Annotated[float, kit.Within(1, 250, "of 500 measurements per second")] = 100.0
    resolution: Literal["cm", "mm"] = "cm"
    save: bool = False
    mount_position_m: kit.Position = (0.12, 0.0, 0.05)
    latency_s: kit.Delay = 0.006
    silence_s: float = Field(0.1, ge=0.01, le=10)

    @field_validator("rate_hz")
    @classmethod
    def _whole(cls, value: float) -> float:
        if value in RATES_HZ:
            return value
        raise ValueError(f"{value:g} Hz is not 500 divided by a whole number, for example 50, 100 or 250")


class TfLuna(kit.SerialModel):
    """The TF-Luna."""

    kind, name, title = "rangefinder", "tf_luna", "Benewake TF-Luna on its serial port"
    config, probe_order, probe_bauds = TfLunaConfig, 2, (115_200,)
    probe_writes = "a request for the version of a TF-Luna, at 115200 baud"
    driver, chip = "hil_rangefinder.driver:TfLunaDriver", "hil_rangefinder.chip:TfLunaChip"


class RangeFinder(kit.DeviceKind):
    """Distance from the robot to what stands in the way of one beam."""

    name, noun, sample = "rangefinder", "range finder", RangeSample
    models, aliases = (TfLuna(),), ("lidar",)
    max_age_s, max_gap_s, min_delivered = 0.02, 0.1, 0.95
    motion_threshold, measures_position = 0.008, True  # m: four times what noise of 3 mm leaves
    topics = (kit.Topic("/range", "sensor_msgs/msg/Range", range_message),)
    plots = (
        kit.Plot("Range", "Distance to the plate (m)", "rangefinder/distance_m"),
        kit.Plot("Range", "Signal strength", "rangefinder/strength"),
    )

    def figures(self, inputs: kit.Inputs) -> Iterator[tuple[str, kit.Figures]]:
        """Distance and strength."""
        for newest in inputs.of("rangefinder")[-1:]:
            yield "rangefinder/distance_m", {"distance": newest.distance_m}
            if not math.isnan(newest.temperature_c):
                yield "rangefinder/strength", {"strength": float(newest.strength)}

    def motion_value(self, sample: RangeSample) -> kit.Array | None:
        """The plate is above the robot, so that its distance shows a slide."""
        return np.array([sample.distance_m]) if sample.status is kit.Status.OK else None

    def check(self, watched: kit.Watched) -> Iterator[kit.Finding]:
        """Samples, echo and distance."""
        aimed = (kit.Status.LOW_CONFIDENCE, kit.Status.IMPLAUSIBLE)
        yield from watched.losses("check wiring and baud rate", but=aimed)
        if not watched.samples:
            return
        good = [s.distance_m for s in watched.samples if s.status is kit.Status.OK]
        strength = median(s.strength for s in watched.samples)
        remedy = "point it at something bright between 0.2 and 8 m away, and clean its lenses"
        level: kit.Level = "ok" if good and strength >= _FAINT else "warning"
        yield kit.Finding(self.name, "echo", level, f"strength {strength:g}", f"{_FAINT} or more", remedy)
        if good:
            text = f"{median(good):.3f} m, spread {1e3 * pstdev(good):.0f} mm"
            yield kit.Finding(self.name, "distance", "ok", text)
