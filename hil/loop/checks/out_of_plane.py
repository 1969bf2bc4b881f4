"""Follows motion capture and camera out of the plane of motion: a robot on its wheels stays in it.

With the other up axis, a plane that is not the wall, or a camera that is mounted in another attitude, the
robot seems to leave the wall, or to tip. That shows as soon as it moves across or turns, for a camera turned
about the vertical, too, whose gravity is right. Deterministic: depends only on the samples since `reset`.
"""

import math

from hil.core.clock import nanoseconds
from hil.core.geometry import Four, Three, conjugated, multiplied, rotated
from hil.core.signals import Event, MocapSample, Status, TrackerSample
from hil.loop.cycle_data import Check, Cycle
from hil.loop.pose_alignment import Mount

_MOST_M, _MOST_RAD = 0.015, 0.07
"""Motion out of the plane, and tilt of the robot in it, that a good plane and body have; robots tip less."""
_CAMERA_RAD = 0.045
"""Tilt that a camera shows over a short stretch beside its noise and the tipping of the robot."""
_STRETCH_NS = nanoseconds(2.0)
"""A camera is followed so long before it begins anew: by then its drift is 2 mm."""
_AGAIN = 5


def tipped_rad(sample: MocapSample) -> float:
    """Angle between the rigid body's z axis and the normal of the plane, rad."""
    _, x, y, _ = sample.quaternion_wxyz.tolist()
    return math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * (x * x + y * y))))


class OutOfPlane(Check):
    """Checks motion capture in one run; reports once."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Clear the state of the run."""
        self._first_m: float | None = None
        self._seen = 0
        self._reported = False

    def on_samples(self, cycle: Cycle) -> None:
        """Follow the samples of a cycle."""
        for sample in cycle.inputs.mocap:
            if not self._reported and sample.status is Status.OK and sample.tracking_valid:
                self._follow(sample, cycle)

    def _follow(self, sample: MocapSample, cycle: Cycle) -> None:
        z_m, tipped = sample.position_m.item(2), tipped_rad(sample)
        if self._first_m is None:
            self._first_m = z_m
        left_m = abs(z_m - self._first_m)
        self._seen = self._seen + 1 if left_m > _MOST_M or tipped > _MOST_RAD else 0
        if self._seen < _AGAIN:
            return
        self._reported = True
        found = f"{1e3 * left_m:.0f} mm off its plane, tipped by {math.degrees(tipped):.1f} deg"
        message = (
            f"motion capture sees the robot {found}, and its wheels stay on it: look at mocap.up_axis, at "
            "the plane, and at the axes of mocap.body"
        )
        cycle.events.append(
            Event(cycle.inputs.t_ns, "warning", "mocap", message, key="mocap.up_axis, mocap.body")
        )


class CameraOutOfPlane(Check):
    """Checks the camera in one run, by its mount in the bench file; reports once.

    Args:
        mount: mount of the camera.
        scale: distance that the camera reports over the true distance.
    """

    def __init__(self, mount: Mount, scale: float) -> None:
        self._mount, self._scale = mount.rotation_wxyz, scale
        self.reset()

    def reset(self) -> None:
        """Clear the state of the run."""
        self._began: tuple[int, Three, Four] | None = None
        self._seen = 0
        self._reported = False

    def on_samples(self, cycle: Cycle) -> None:
        """Follow the newest sample of a cycle."""
        if cycle.inputs.tracker and not self._reported:
            self._follow(cycle.inputs.tracker[-1], cycle)

    def _follow(self, sample: TrackerSample, cycle: Cycle) -> None:
        t_ns, began = sample.stamp.t_ns, self._began
        if sample.status is not Status.OK:
            self._began = None
            return
        q, (x_m, y_m, z_m) = sample.quaternion_wxyz.tolist(), sample.position_m.tolist()
        if began is None or not 0 <= t_ns - began[0] < _STRETCH_NS:
            self._began, self._seen = (t_ns, (x_m, y_m, z_m), conjugated(q)), 0
            return
        _, first, back = began
        turn = multiplied(self._mount, multiplied(multiplied(back, q), conjugated(self._mount)))
        way = rotated(self._mount, rotated(back, (x_m - first[0], y_m - first[1], z_m - first[2])))
        out_m, along_m = abs(way[2]) / self._scale, math.hypot(way[0], way[1]) / self._scale
        tipped = 2.0 * math.asin(min(1.0, math.hypot(turn[1], turn[2])))
        turned = 2.0 * abs(math.atan2(turn[3], turn[0]))
        leaves = out_m > max(_MOST_M, along_m) or tipped > max(_CAMERA_RAD, turned)
        self._seen = self._seen + 1 if leaves else 0
        if self._seen < _AGAIN:
            return
        self._reported = True
        message = (
            f"the camera sees the robot {1e3 * out_m:.0f} mm off its plane and {1e3 * along_m:.0f} mm along "
            f"it, tipped by {math.degrees(tipped):.1f} deg and turned by {math.degrees(turned):.1f}, and its "
            "wheels stay on the surface: look at tracker.mount_rotation_wxyz"
        )
        cycle.events.append(
            Event(cycle.inputs.t_ns, "warning", "tracker", message, key="tracker.mount_rotation_wxyz")
        )
