"""True imperfections of the emulated visual-inertial computer."""

from __future__ import annotations

from dataclasses import dataclass

from hil.devices.tracker.mavlink.config import PoseFrame
from hil.fakes.tracker.options import TrackerTruthOptions


@dataclass(frozen=True)
class ComputerTruthOptions(TrackerTruthOptions):
    """What one computer does wrong, beside what every tracking camera does.

    Attributes:
        rate_hz: poses per second.
        network_s: time that a datagram takes, one way.
        settle_s: time with quality -1 (failed), then 10, then 35, before it is 90.
        system_id, component_id: MAVLink ids; component 197 is visual-inertial odometry.
        frame: of the poses.
        twist_in_body: whether the twist is given in BODY_FRD, not in the frame of the pose.
        sends_covariance, sends_quality, sends_heartbeat, answers_timesync: whether it does.
    """

    rate_hz: float = 100.0
    network_s: float = 0.0003
    system_id: int = 1
    component_id: int = 197
    frame: PoseFrame = "LOCAL_FRD"
    twist_in_body: bool = True
    sends_covariance: bool = True
    sends_quality: bool = True
    sends_heartbeat: bool = True
    answers_timesync: bool = True


IDEAL = ComputerTruthOptions(
    scale_sigma=0.0,
    yaw_rate_sigma_rad_s=0.0,
    yaw_walk_rad_sqrt_s=0.0,
    position_walk_m_sqrt_m=0.0,
    position_noise_m=0.0,
    angle_noise_rad=0.0,
    velocity_noise_m_s=0.0,
    rate_noise_rad_s=0.0,
    jitter_s=0.0,
    clock_ppm=0.0,
    drop_probability=0.0,
    settle_s=(0.0, 0.0, 0.0),
)
"""A computer without errors: 20 ms late, otherwise true to single precision."""
