"""True imperfections of the emulated capture system, as measured on public recordings."""

from dataclasses import dataclass
from typing import Annotated, Literal

from hil.config.field_types import UnitQuaternion, Within


@dataclass(frozen=True)
class MocapTruthOptions:
    """True imperfections of the capture system, as in the authors' recordings.

    Attributes:
        rate_hz: frames per second, 100 or 240 as Motive is usually set.
        position_noise_m, angle_noise_rad: white noise per axis: 10 um and 0.04 mrad at rest.
        marker_error_m: mean marker error that Motive reports.
        height_m: the body's pivot above the surface.
        plane_rotation_wxyz: axes of the calibrated plane in the wall frame: (1, 0, 0, 0) where x points up
            the wall and z out of it.
        body_rotation_wxyz: axes of the rigid body in the robot: (1, 0, 0, 0) where it was defined with the
            robot's own.
        gaps_per_s: losses of one or several frames; 50 to 152 per run of 80 s were recorded.
        single_gap_share: part of the gaps that lose one frame.
        common_gap_s, longest_gap_s: the other gaps last up to this, one in fifty up to the longest.
        occlusions_per_s, occlusion_s: rate and duration of the times in which the body is out of sight.
        latency_s: exposure to sending.
        transit_s: sending to arrival, the smallest.
        jitter_s: mean of the exponential jitter beside it.
        stalls_per_s, longest_stall_s: arrivals that are held up, with all behind them.
        clock_ppm: error of the server's clock, standard deviation over servers.
        stamp_late_s: mean of an exponential lateness: frames are sent and stamped later than they were
            exposed, each by another time but in their order, as where a program stamps them on arrival. The
            recordings of 64 frames a second are late by 0 to 60 ms; frame numbers give their times.
        exposure_jitter_s: deviation of the exposure from the regular time of its number, one sigma.
        moving_angle_noise_rad: further noise of the heading while the body moves, one sigma; 0.5 mrad in the
            recordings.
        moving_noise_s: time constant of both; 0 for values that do not depend on those before.
        natnet: version that the server speaks unless a client asks for an earlier one.
    """

    rate_hz: float = 100.0
    position_noise_m: float = 10e-6
    angle_noise_rad: float = 40e-6
    marker_error_m: float = 0.0002
    height_m: float = 0.08
    plane_rotation_wxyz: UnitQuaternion = (1.0, 0.0, 0.0, 0.0)
    body_rotation_wxyz: UnitQuaternion = (1.0, 0.0, 0.0, 0.0)
    gaps_per_s: float = 1.3
    single_gap_share: float = 0.5
    common_gap_s: float = 0.08
    longest_gap_s: float = 0.2
    occlusions_per_s: float = 0.0
    occlusion_s: float = 0.3
    latency_s: float = 0.004
    transit_s: float = 0.0002
    jitter_s: float = 0.0005
    stalls_per_s: float = 0.05
    longest_stall_s: float = 0.2
    clock_ppm: float = 14.0
    stamp_late_s: Annotated[float, Within(0.0, 1.0, "later than any usable frame")] = 0.0
    exposure_jitter_s: Annotated[float, Within(0.0, 0.1, "more than several periods")] = 0.0
    moving_angle_noise_rad: Annotated[float, Within(0.0, 0.1, "6 degrees")] = 0.0
    moving_noise_s: Annotated[float, Within(0.0, 10.0, "a time constant")] = 0.01
    natnet: Literal["3.1", "4.0", "4.1"] = "4.1"


STILL = MocapTruthOptions(
    position_noise_m=0.0, angle_noise_rad=0.0, gaps_per_s=0.0, jitter_s=0.0, stalls_per_s=0.0, clock_ppm=0.0
)
"""A capture system without noise, gaps and jitter; its frames are still 4 ms old when sent."""
