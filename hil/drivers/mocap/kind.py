"""Motion capture: the pose of the robot's rigid body, seen from outside."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hil.core.clock import nanoseconds
from hil.core.device import DeviceKind, Figures, Plot, Topic, by_axis
from hil.core.finding import Finding, Level
from hil.core.geometry import Array
from hil.core.signals import Inputs, MocapSample, Status
from hil.drivers.doctor_watch import LOSS_FAILURE, Watched
from hil.drivers.mocap.natnet.model import NatNet

if TYPE_CHECKING:
    from hil.recording.rosbags_adapter import MessageMaker

__all__ = ["KIND"]


_LATE_S, _GAP_S = 0.05, 0.3


def look(watched: Watched) -> Iterator[Finding]:
    """Findings about motion capture that was watched."""
    samples, watch_s = watched.samples, watched.watch_s
    tracked = [s for s in samples if s.tracking_valid and s.status is Status.OK]
    share = len(tracked) / len(samples) if samples else 0.0
    now_ns = watched.clock.now_ns()
    seen_ns = [now_ns - nanoseconds(watch_s), *(s.stamp.host_ns for s in tracked), now_ns]
    gap_s = 1e-9 * max(b - a for a, b in pairwise(seen_ns))
    level: Level = "ok" if share > 1.0 - LOSS_FAILURE and gap_s < _GAP_S else "failure"
    message = (
        f"{len(tracked)} of {len(samples)} frames, {len(samples) / watch_s:.0f} Hz, longest gap {gap_s:.2f} s"
    )
    yield Finding(
        "mocap",
        "tracking",
        level,
        message,
        f"nearly all frames tracked, gaps below {_GAP_S:g} s",
        "check markers, occlusion and the rigid body's definition",
    )
    if tracked:
        latency_s = float(np.median([s.latency_s for s in tracked]))
        late = not math.isfinite(latency_s) or latency_s > _LATE_S
        yield Finding(
            "mocap",
            "latency",
            "warning" if late else "ok",
            f"{latency_s * 1e3:.1f} ms",
            f"below {_LATE_S * 1e3:g} ms",
            "use a wired network",
        )


_OK = Status.OK


def _pose(sample: MocapSample, ros: MessageMaker) -> Any:
    """`geometry_msgs/PoseStamped` in the capture frame; None where the body is not tracked."""
    if not sample.tracking_valid:
        return None
    return ros.pose_stamped(sample.stamp.t_ns, "mocap", sample.position_m, sample.quaternion_wxyz)


class Mocap(DeviceKind):
    """The pose of a rigid body, seen from outside."""

    name, noun, sample = "mocap", "motion capture", MocapSample
    models = (NatNet(),)
    max_age_s, max_gap_s, min_delivered = 0.05, 0.5, 0.8
    has_own_clock = True
    topics = (Topic("/mocap/pose", "geometry_msgs/msg/PoseStamped", _pose),)
    plots = (Plot("Sensors", "Position by motion capture (m)", "mocap/position_m"),)
    motion_threshold, measures_position = 0.0005, True
    silent_faults: ClassVar[Mapping[str, str]] = {
        "intermittent": "the stream is judged second by second: reported within two seconds of a longer run",
        "delayed": "the stream is judged second by second: reported within two seconds of a longer run",
    }

    def rate_hz(self, config: Any, loop_hz: float) -> float:
        """NaN: the capture system sets it."""
        return math.nan

    def motion_value(self, sample: MocapSample) -> Array | None:
        """Position (3,) in m."""
        return sample.position_m if sample.status is _OK and sample.tracking_valid else None

    def figures(self, inputs: Inputs) -> Iterator[tuple[str, Figures]]:
        """Position in the capture frame."""
        if inputs.mocap:
            yield "mocap/position_m", by_axis(inputs.mocap[-1].position_m)

    def check(self, watched: Watched) -> Iterator[Finding]:
        """Tracked frames, gaps, latency."""
        return look(watched)


KIND = Mocap()
