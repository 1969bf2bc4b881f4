"""True imperfections of the emulated visual-inertial computer."""

from __future__ import annotations

from dataclasses import dataclass, fields

from hil.devices.tracker.mavlink.config import MavlinkId, PoseFrame
from hil.fakes.tracker.t265_truth import IDEAL as IDEAL_CAMERA
from hil.fakes.tracker.t265_truth import TrackerTruthOptions


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
    system_id: MavlinkId = 1
    component_id: MavlinkId = 197
    frame: PoseFrame = "LOCAL_FRD"
    twist_in_body: bool = True
    sends_covariance: bool = True
    sends_quality: bool = True
    sends_heartbeat: bool = True
    answers_timesync: bool = True


IDEAL = ComputerTruthOptions(**{f.name: getattr(IDEAL_CAMERA, f.name) for f in fields(IDEAL_CAMERA)})
"""A computer without errors: 20 ms late, otherwise true to single precision."""
