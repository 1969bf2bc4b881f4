"""The emulated visual-inertial computer: odometry with errors, heartbeats, answers, on a clock of its own.

It does not depend on the transport: `emulated_links` carries its packets as datagrams in world time, on a
serial line or on real UDP. It streams to all attached outlets.
"""

from __future__ import annotations

import heapq
import itertools
import math
from abc import abstractmethod
from dataclasses import dataclass, fields
from typing import Any, Protocol

from hil.config.mavlink import MavlinkId, PoseFrame
from hil.core.clock import NS_PER_S, nanoseconds
from hil.fakes.body_interface import BodyMotion
from hil.fakes.emulation_request import EmulationRequest
from hil.fakes.tracker.mavlink.faults import ComputerFaults
from hil.fakes.tracker.mavlink.odometry import estimate_of
from hil.fakes.tracker.true_parameters import IDEAL as IDEAL_CAMERA
from hil.fakes.tracker.true_parameters import TrackerTruthOptions
from hil.fakes.tracker.visual_odometry import VisualOdometry
from hil.fakes.world import Scheduled, World
from hil.links.mavlink.messages import Parser, dialect


@dataclass(frozen=True)
class ComputerTruthOptions(TrackerTruthOptions):
    """True imperfections of one computer, beside those of every tracking camera.

    Attributes:
        rate_hz: poses per second.
        network_s: time that a datagram takes, one way.
        settle_s: time with quality -1 (failed), then 10, then 35, before it is 90.
        system_id, component_id: MAVLink ids; component 197 is visual-inertial odometry.
        frame: frame of the poses, without MAV_FRAME_.
        twist_in_body: true if the twist is given in BODY_FRD, not in the frame of the pose.
        sends_covariance, sends_quality, sends_heartbeat, answers_timesync: true if it does so.
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


_HEARTBEAT_NS = NS_PER_S
_ANSWER_NS = 100_000
_LONGEST_UP_NS = 100_000 * NS_PER_S
_QUALITIES = (-1, 10, 35, 90)
_DOUBTED_QUALITY, _UNKNOWN_QUALITY = 10, 0
_FIRMWARE = 1 << 24 | 4 << 16 | 2 << 8


class Outlet(Protocol):
    """One connection to a receiver."""

    @abstractmethod
    def deliver(self, packet: bytes, t_ns: int) -> None:
        """Take a packet that leaves the computer now, at `t_ns`."""


_OF_ITS_OWN = ("system_id", "component_id", "frame")


class VisualInertialComputer(Scheduled):
    """The computer, a scheduled part of the world.

    Args:
        world: truth, seed and faults; the computer registers itself.
        name: device name, also of its faults.
        options: true imperfections.
        mount_position_m, mount_rotation_wxyz: camera (robot axes) in the body, unless the options say
            where it truly is.

    Attributes:
        options: true imperfections, as given.
        faults: its active faults.

    Raises:
        ConfigError: pymavlink is missing.
    """

    Options = ComputerTruthOptions

    @classmethod
    def build(cls, request: EmulationRequest) -> VisualInertialComputer:
        """The computer of a table of the bench file, with the ids that the bench looks for."""
        config = request.config
        wanted = {key: getattr(config, key) for key in _OF_ITS_OWN if getattr(config, key) is not None}
        return cls(
            request.world,
            name=request.kind,
            options=request.options(cls.Options, rate_hz=config.rate_hz, **wanted),
            mount_position_m=config.mount_position_m,
            mount_rotation_wxyz=config.mount_rotation_wxyz,
        )

    def __init__(
        self,
        world: World,
        name: str = "tracker",
        options: ComputerTruthOptions | None = None,
        *,
        mount_position_m: tuple[float, float, float] = (0.1489, 0.0092, 0.0666),
        mount_rotation_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
    ) -> None:
        self.name, self._world = name, world
        self._common = dialect()
        self.options = options if options is not None else ComputerTruthOptions()
        self._rng = world.rng(name)
        self.odometry = VisualOdometry(
            self.options,
            self._rng,
            mount_position_m=self.options.mount_position_m or mount_position_m,
            mount_rotation_wxyz=self.options.mount_rotation_wxyz or mount_rotation_wxyz,
        )
        self._serial = int(self._rng.integers(1, 1 << 62))
        self._up_ns = int(self._rng.integers(0, _LONGEST_UP_NS))
        self._stretch = 1.0 + 1e-6 * self.options.clock_ppm * float(self._rng.standard_normal())
        self.faults = ComputerFaults(world.faults, name, self._rng)
        self._outlets: list[Outlet] = []
        self._requests: list[tuple[int, int, bytes, Outlet]] = []
        self._leaving: list[tuple[int, int, Any, Outlet | None]] = []
        self._order = itertools.count()
        self._writer = self._common.MAVLink(
            None, srcSystem=self.options.system_id, srcComponent=self.options.component_id
        )
        self._exposure_ns = self._beat_ns = 0
        self._boot(0)
        world.add(self)

    @property
    def now_ns(self) -> int:
        """World time, ns."""
        return self._world.now_ns

    def attach(self, outlet: Outlet) -> None:
        """Add an outlet to stream to."""
        if outlet not in self._outlets:
            self._outlets.append(outlet)

    def detach(self, outlet: Outlet) -> None:
        """Stop streaming to an outlet. Idempotent."""
        self._outlets = [other for other in self._outlets if other is not outlet]

    def hear(self, packet: bytes, arrives_ns: int, outlet: Outlet) -> None:
        """Take bytes that arrive at `arrives_ns`; answers go back through the outlet."""
        heapq.heappush(self._requests, (arrives_ns, next(self._order), packet, outlet))

    def next_due_ns(self) -> int:
        """Time of the next exposure, heartbeat, request or departure."""
        due_ns: int = min(self._exposure_ns, self._beat_ns)
        for queue in (self._requests, self._leaving):
            if queue:
                due_ns = min(due_ns, queue[0][0])
        return due_ns

    def on_due(self, t_ns: int) -> None:
        """Answer requests, send a heartbeat, expose, and send the messages that are due."""
        if self.faults.restarted(t_ns):
            self._boot(t_ns)
        while self._requests and self._requests[0][0] <= t_ns:
            _, _, packet, outlet = heapq.heappop(self._requests)
            if not self.faults.silent(t_ns) and t_ns >= self._booted_ns:
                self._answer(packet, t_ns, outlet)
        if t_ns >= self._beat_ns:
            self._beat_ns = t_ns + _HEARTBEAT_NS
            if self.options.sends_heartbeat:
                self._plan(self._heartbeat(), t_ns)
        if t_ns >= self._exposure_ns:
            self._expose(t_ns)
        while self._leaving and self._leaving[0][0] <= t_ns:
            _, _, message, only = heapq.heappop(self._leaving)
            self._let_go(message, t_ns, only)

    def device_ns(self, t_ns: int) -> int:
        """The computer's own clock at a world time: its uptime in ns, random at the beginning."""
        return self._up_ns + round((t_ns - self._zero_ns) / self._stretch)

    def _boot(self, t_ns: int) -> None:
        """Restart odometry and reset count and, except at the first boot, the clock."""
        if t_ns > 0:
            self._up_ns = 0
        self.odometry.restart()
        self._resets, self._travelled_m = 0, 0.0
        self._zero_ns = self._exposed_ns = t_ns
        self._low_confidence_until_ns = self._left_ns = 0
        self._leaving.clear()
        self._booted_ns = t_ns + nanoseconds(self.options.boot_s)
        self._exposure_ns = self._beat_ns = self._booted_ns

    def _expose(self, t_ns: int) -> None:
        options, faults = self.options, self.faults
        period_s = self._stretch * faults.period_factor(t_ns) / options.rate_hz
        self._exposure_ns = t_ns + round(NS_PER_S * period_s)
        dt_s, self._exposed_ns = (t_ns - self._exposed_ns) / NS_PER_S, t_ns
        body = self._world.plant.body()
        self._relocalise(t_ns, dt_s)
        self.odometry.drift(*faults.drift_m(t_ns, dt_s))
        pose = self.odometry.observe(body, dt_s, faults.scale(t_ns))
        self._travelled_m += dt_s * math.hypot(body.v_x_m_s, body.v_y_m_s)
        lost, jitter = self._rng.random(), self._rng.standard_exponential()
        if lost < options.drop_probability:
            return
        sigmas = self._sigmas() if options.sends_covariance else (None, None)
        estimate = estimate_of(
            pose,
            time_us=self.device_ns(t_ns) // 1000,
            frame=options.frame,
            twist_in_body=options.twist_in_body,
            pose_sigma=sigmas[0],
            twist_sigma=sigmas[1],
            resets=self._resets,
            quality=self._quality(body, t_ns) if options.sends_quality else _UNKNOWN_QUALITY,
        )
        late_ns = nanoseconds(options.latency_s + options.jitter_s * jitter) + faults.lateness_ns(t_ns)
        self._left_ns = max(t_ns + late_ns, self._left_ns)
        if not faults.none:
            estimate = faults.distort(estimate, t_ns)
        self._plan(estimate.message(self._common), self._left_ns)

    def _relocalise(self, t_ns: int, dt_s: float) -> None:
        rate = self.options.relocalisations_per_s
        if rate > 0.0 and self._rng.random() < rate * dt_s:
            self.odometry.jump(self.options.relocalisation_m)
            self._resets = (self._resets + 1) % 256
        distance_m, announced = self.faults.jump(t_ns)
        if distance_m:
            self.odometry.jump(distance_m)
            self._resets = (self._resets + announced) % 256

    def _sigmas(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Standard deviations that it reports: noise, and the random walk since its start."""
        options = self.options
        walked_m = options.position_walk_m_sqrt_m * math.sqrt(self._travelled_m)
        pose = math.hypot(options.position_noise_m, walked_m), options.angle_noise_rad
        return pose, (options.velocity_noise_m_s, options.rate_noise_rad_s)

    def _quality(self, body: BodyMotion, t_ns: int) -> int:
        """Quality in percent: low for some time after the start and after fast motion."""
        vx, vy, omega = body.v_x_m_s, body.v_y_m_s, body.omega_rad_s
        options = self.options
        if abs(omega) > options.fast_rad_s or math.hypot(vx, vy) > options.fast_m_s:
            self._low_confidence_until_ns = t_ns + nanoseconds(options.low_confidence_s)
        if t_ns < self._low_confidence_until_ns:
            return _DOUBTED_QUALITY
        age_s = (t_ns - self._booted_ns) / NS_PER_S
        steps = itertools.accumulate(options.settle_s)
        return _QUALITIES[sum(age_s >= until_s for until_s in steps)]

    def _heartbeat(self) -> Any:
        common = self._common
        return common.MAVLink_heartbeat_message(
            common.MAV_TYPE_ONBOARD_CONTROLLER, common.MAV_AUTOPILOT_INVALID, 0, 0, common.MAV_STATE_ACTIVE, 3
        )

    def _answer(self, data: bytes, t_ns: int, outlet: Outlet) -> None:
        common = self._common
        for message in Parser(common, datagrams=True).feed(data):
            kind = message.get_type()
            if kind == "TIMESYNC" and message.tc1 == 0 and self.options.answers_timesync:
                mirrored = common.MAVLink_timesync_message(self.device_ns(t_ns), message.ts1)
                self._plan(mirrored, t_ns, outlet)
            elif kind == "COMMAND_LONG" and message.command == common.MAV_CMD_REQUEST_MESSAGE:
                asked = (message.target_system, message.target_component, message.param1)
                mine = self.options.system_id, self.options.component_id
                if asked == (*mine, common.MAVLINK_MSG_ID_AUTOPILOT_VERSION):
                    self._plan(self._version(), t_ns + _ANSWER_NS, outlet)

    def _version(self) -> Any:
        nothing = [0] * 8
        return self._common.MAVLink_autopilot_version_message(
            0, _FIRMWARE, 0, 0, 0, nothing, nothing, nothing, 0, 0, self._serial
        )

    def _plan(self, message: Any, ready_ns: int, outlet: Outlet | None = None) -> None:
        """Queue a message that leaves at `ready_ns`, by one outlet or by all."""
        heapq.heappush(self._leaving, (ready_ns, next(self._order), message, outlet))

    def _let_go(self, message: Any, t_ns: int, only: Outlet | None) -> None:
        outlets = [outlet for outlet in self._outlets if only is None or outlet is only]
        if not outlets or self.faults.silent(t_ns):
            return
        packet = bytes(message.pack(self._writer))
        self._writer.seq = (self._writer.seq + 1) % 256
        if not self.faults.none:
            packet = self.faults.scramble(packet, t_ns)
        for outlet in outlets:
            outlet.deliver(packet, t_ns)
