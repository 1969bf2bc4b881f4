"""Tracking cameras: the pose relative to their start, by visual-inertial odometry."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from hil.core.device import DeviceKind, Figures, Plot, Topic, by_axis
from hil.core.finding import Finding
from hil.core.geometry import Array
from hil.core.signals import Inputs, Status, TrackerSample
from hil.drivers.doctor_watch import Watched, losses
from hil.drivers.tracker.mavlink.model import Mavlink
from hil.drivers.tracker.t265.model import T265

if TYPE_CHECKING:
    from hil.recording.rosbags_adapter import MessageMaker

__all__ = ["KIND"]


_SLOWEST = 0.9
_UNSURE = "clean the lenses, light the scene, check that the camera is not shaking"
_FEW = "use a USB 3 port or a faster link, or set tracker.rate_hz to what is sent, where the table has it"


def look(watched: Watched) -> Iterator[Finding]:
    """Findings about a camera that was watched."""
    statuses, due = [s.status for s in watched.samples], watched.due
    if len(statuses) >= _SLOWEST * due:
        due = min(due, len(statuses))  # the true rate may be a little below the configured one
    unsure = any(status not in (Status.OK, Status.STARTING) for status in statuses)
    yield losses("tracker", statuses, due, _UNSURE if unsure else _FEW)
    if watched.samples:
        confidence = watched.samples[-1].confidence
        yield Finding(
            "tracker",
            "confidence",
            "ok" if confidence >= 2 else "warning",
            f"{confidence} of 3",
            "2 or 3",
            "move the camera a little; the scene needs texture",
        )


_OK = Status.OK


def _pose(sample: TrackerSample, ros: MessageMaker) -> Any:
    """`geometry_msgs/PoseStamped` in the camera's start frame."""
    t_ns = sample.stamp.t_ns
    return ros.pose_stamped(t_ns, "tracker_start", sample.position_m, sample.quaternion_wxyz)


class Tracker(DeviceKind):
    """The pose relative to the camera's start, by visual-inertial odometry."""

    name, noun, sample = "tracker", "camera", TrackerSample
    models = (T265(), Mavlink())
    max_age_s, max_gap_s, min_delivered = 0.05, 0.1, 0.95
    has_own_clock = True
    topics = (Topic("/tracker/pose", "geometry_msgs/msg/PoseStamped", _pose),)
    plots = (Plot("Sensors", "Position by the camera (m)", "tracker/position_m"),)
    motion_threshold, measures_position = 0.001, True  # m: noise of 0.5 mm leaves 0.1 in the mean

    def stale_after_s(self, safety: Any, config: Any) -> float:
        """`safety.tracker_stale_s`."""
        return float(safety.tracker_stale_s)

    def rate_hz(self, config: Any, loop_hz: float) -> float:
        """Sample rate of its table, else 200 Hz."""
        return float(getattr(config, "rate_hz", 200.0))

    def motion_value(self, sample: TrackerSample) -> Array | None:
        """Position (3,) in m."""
        return sample.position_m if sample.status is _OK else None

    def figures(self, inputs: Inputs) -> Iterator[tuple[str, Figures]]:
        """Position in the frame in which the camera started."""
        if inputs.tracker:
            yield "tracker/position_m", by_axis(inputs.tracker[-1].position_m)

    def check(self, watched: Watched) -> Iterator[Finding]:
        """Findings on samples and tracking confidence."""
        return look(watched)


KIND = Tracker()
