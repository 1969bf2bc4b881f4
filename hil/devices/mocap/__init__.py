"""Motion capture: the pose of the robot's rigid body, seen from outside."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hil.config.mocap import MocapConfig
from hil.core.clock import nanoseconds
from hil.core.device import Connection, DeviceKind, DeviceModel, Found, Search, Topic, can_open
from hil.core.finding import Finding, Level
from hil.core.geometry import Array
from hil.core.signals import MocapSample, Status
from hil.devices.doctor_watch import LOSS_FAILURE, Watched

if TYPE_CHECKING:
    from hil.recording.ros_types import MessageMaker

__all__ = ["KIND"]


_MOTIVE_PORTS = {"command_port": 1510, "data_port": 1511}
_MOTIVE_GROUP = "239.255.42.99"


class NatNet(DeviceModel):
    """OptiTrack Motive, reached by UDP at several ports; in one process the emulator passes datagrams."""

    kind, name, title = "mocap", "natnet", "OptiTrack Motive over NatNet"
    config, wire = MocapConfig, "udp"
    driver, chip = "hil.drivers.mocap:NatNetMocap", "hil.fakes.mocap:NatNetServer"

    def emulate(self, request: Any) -> Any:
        """Emulate a NatNet server."""
        from hil.devices.emulated_device import Wired
        from hil.fakes.mocap import NatNetServer, NatNetTransport

        server, config = NatNetServer.build(request), request.config
        if request.standard_ports:
            server.offered_group = _MOTIVE_GROUP
        chosen = {key: getattr(config, key) for key in _MOTIVE_PORTS if key in config.model_fields_set}
        ports = _MOTIVE_PORTS if request.standard_ports else chosen
        return Wired(
            lambda: Connection(parts={"datagrams": server.datagrams}),
            lambda: NatNetTransport(server, **ports),
        )

    def connection(self, endpoint: Mapping[str, Any]) -> Mapping[str, Any]:
        """Keys of the bench file that reach an emulated server."""
        where = {key: endpoint[key] for key in ("server", "command_port", "data_port", "multicast")}
        return {**where, "local_address": endpoint["server"]}

    def search(self, search: Search) -> Found | None:
        """Query the capture servers that the user has named."""
        for config in search.given.get("mocap", ()):
            search.say(f"asking the capture server {config.server}")
            if can_open(self.make_driver(config, search.clock)):
                return Found(config.model_dump(mode="json", exclude_none=True, exclude_defaults=True))
        return None


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

    def check(self, watched: Watched) -> Iterator[Finding]:
        """Tracked frames, gaps, latency."""
        return look(watched)


KIND = Mocap()
