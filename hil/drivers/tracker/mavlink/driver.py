"""Driver of a visual-inertial computer: MAVLink odometry on the bench clock, with a status for each pose.

Poses come in robot axes in the z-up frame in which the sender gives them: it starts where the sender's
does, or has x north (LOCAL_NED) or east (LOCAL_ENU). Velocities are in the axes of that frame.
"""

import logging
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hil.config.mavlink import MavlinkTrackerConfig
from hil.core.clock import NS_PER_S, Clock, nanoseconds
from hil.core.finding import Finding
from hil.core.interfaces import Sensor
from hil.core.signals import Stamp, Status, TrackerSample
from hil.drivers.tracker.mavlink.doctor_check import diagnose
from hil.drivers.tracker.mavlink.first_contact import await_sender, silent
from hil.drivers.tracker.mavlink.session import Received, Session
from hil.drivers.tracker.mavlink.transports import open_link
from hil.links.injection import FaultyDatagrams, with_faults
from hil.links.mavlink import messages as odometry_messages
from hil.links.mavlink.transport_interface import LinkFactory
from hil.streams.pose_stream import USABLE_CONFIDENCE, WITHOUT_POSE, PoseStream
from hil.streams.silence_limit import USELESS, SilenceTimer, nothing_usable, used_while_closed

_LOG = logging.getLogger(__name__)

_NS_PER_US = 1000
_LATEST_US = 1 << 62
_RESTART_NS = NS_PER_S
_EARLY_NS, _LATE_NS = nanoseconds(0.005), nanoseconds(5.0)
_NAN7, _NAN6 = (math.nan,) * 7, (math.nan,) * 6
_USELESS = (*USELESS, Status.PROTOCOL)
_NO_POSE = (*WITHOUT_POSE, Status.PROTOCOL)


class MavlinkTracker(Sensor[TrackerSample]):
    """One sender of odometry.

    Args:
        config: its address, its system and component, and how its poses are judged.
        clock: the bench clock.
        link: function that opens the link to the sender; the configured one by default.
    """

    name = "tracker"

    def __init__(self, config: MavlinkTrackerConfig, clock: Clock, link: LinkFactory = open_link) -> None:
        self._config, self._clock, self._open_link = config, clock, link
        self._session: Session | None = None
        self._identity: dict[str, str] = {}
        self._poses = PoseStream(config, config.latency_s)
        self._silence_timer = SilenceTimer(config.fail_after_s)
        self._seq, self._last_t_ns = 0, -(1 << 62)
        self._forget()

    @property
    def counts(self) -> Mapping[str, int]:
        """Counts since `open`: packets malformed, of other senders, lost, unread; floods; poses not new."""
        names = ("malformed", "strangers", "lost", "overflowed", "floods")
        session = self._session
        counts = {name: 0 if session is None else getattr(session, name) for name in names}
        return {**counts, "repeated": self._repeated}

    def open(self) -> None:
        """Open the link, find the sender, wait for its first pose, and read its identity.

        Raises:
            DeviceTimeoutError: no odometry arrives.
            ConfigError: pymavlink is missing.
            DeviceError: the port cannot be used, or the sender is not the configured one, or sends poses in
                frames that cannot be used.
        """
        self.close()
        self._forget()
        common = odometry_messages.dialect()
        link = self._open_link(self._config, self._clock, self.name)
        if link.datagrams:
            link = with_faults(link, FaultyDatagrams)
        self._session = session = Session(link, common, self._config, self._clock)
        try:
            self._identity = await_sender(session, self._config, self._clock, common, self.name)
        except BaseException:
            self.close()
            raise
        now_ns = self._clock.now_ns()
        self._silence_timer.begin(now_ns)
        self._poses.wait(now_ns)

    def reopen(self) -> None:
        """Open again after an outage: sample numbers go on, perhaps in another frame."""
        self.open()
        self._poses.begin_again()

    @property
    def port_gone(self) -> bool:
        """Whether the port itself has failed repeatedly; a silent network looks like a silent sender."""
        return self._session is not None and self._session.port_gone

    def close(self) -> None:
        """Close the link. Idempotent; never raises."""
        self._identity = {}
        if self._session is not None:
            self._session.close()
            self._session = None

    def identity(self) -> Mapping[str, str]:
        """Ids, kind and firmware of the sender, and its frames; empty while closed."""
        return self._identity

    def read(self) -> tuple[TrackerSample, ...]:
        """All poses since the last call, oldest first.

        Raises:
            DeviceError: it is closed.
            DeviceTimeoutError: no usable pose for `fail_after_s`.
        """
        session = self._session
        if session is None:
            raise used_while_closed(self.name, self._config.port)
        session.exchange()
        samples = []
        while session.odometry:
            sample = self._sample(session, session.odometry.popleft())
            if sample is not None:
                samples.append(sample)
        now_ns = self._clock.now_ns()
        useful = any(sample.status not in _USELESS for sample in samples)
        if overdue_ns := self._silence_timer.overdue_ns(useful, now_ns):
            what = nothing_usable("pose", overdue_ns, samples)
            if self._repeated:
                what += f"; {self._repeated} poses were no newer than the one before"
            raise silent(session, self._config, self.name, what)
        return tuple(samples)

    def findings(self, samples: Sequence[TrackerSample] = (), watched_s: float = 0.0) -> tuple[Finding, ...]:
        """Findings on the sender, the link, and samples read during `watched_s`."""
        if self._session is None:
            return ()
        return tuple(diagnose(self._session, self._config, self.name, samples, watched_s))

    def _forget(self) -> None:
        self._poses.begin(self._clock.now_ns())
        self._repeated = 0
        self._last_device_ns: int | None = None
        self._resets: int | None = None

    def _sample(self, session: Session, received: Received) -> TrackerSample | None:
        """The sample of one message; None when its pose is no newer than the last one."""
        message, host_ns = received
        device_ns, credible = message.time_usec * _NS_PER_US, message.time_usec < _LATEST_US
        t_ns = host_ns
        if credible:
            age_ns = 0 if self._last_device_ns is None else device_ns - self._last_device_ns
            if self._last_device_ns is not None and -_RESTART_NS < age_ns <= 0:
                self._repeated += 1
                return None
            t_ns, credible = self._bench_time(session, device_ns, host_ns)
        self._note_reset(message, device_ns if credible else None)
        pose, twist, status = self._judge(message, t_ns, host_ns, credible)
        if status in _NO_POSE:
            pose, twist = _NAN7, _NAN6
        self._seq += 1
        return TrackerSample(
            stamp=Stamp(t_ns, host_ns, self._seq, device_ns if credible else None),
            position_m=np.array(pose[:3]),
            quaternion_wxyz=np.array(pose[3:]),
            velocity_m_s=np.array(twist[:3]),
            angular_velocity_rad_s=np.array(twist[3:]),
            confidence=self._confidence(message.quality),
            status=status,
        )

    def _bench_time(self, session: Session, device_ns: int, host_ns: int) -> tuple[int, bool]:
        """Bench time of a pose, and whether its stamp is credible; credible times always rise.

        The offset comes from TIMESYNC round trips; where the sender answers none, or stamps its poses by
        another clock, from the quickest arrivals.
        """
        t_ns, credible = self._poses.clock_map.map(device_ns, host_ns)
        trip = session.trip()
        if trip is not None:
            if -_EARLY_NS < host_ns - device_ns - trip.offset_ns < _LATE_NS:
                t_ns, credible = min(device_ns + trip.offset_ns, host_ns), True
                session.other_clock = 0
            else:
                session.other_clock += 1
        if credible:
            t_ns = self._last_t_ns = min(max(t_ns, self._last_t_ns + 1), max(host_ns, self._last_t_ns + 1))
        return t_ns, credible

    def _note_reset(self, message: Any, device_ns: int | None) -> None:
        """Distrust the next poses where the sender reports a reset of its estimate, or has restarted.

        The first usable pose after that has status RESET.
        """
        resets, self._resets = self._resets, message.reset_counter
        reset = resets is not None and resets != message.reset_counter
        if device_ns is not None:
            restarted = self._last_device_ns is not None and device_ns < self._last_device_ns
            self._last_device_ns = device_ns
            if restarted:
                _LOG.warning("%s has started again", self.name)
            reset = reset or restarted
        if reset:
            self._poses.begin_again()

    def _judge(
        self, message: Any, t_ns: int, host_ns: int, credible: bool
    ) -> tuple[tuple[float, ...], tuple[float, ...], Status]:
        """Pose, twist and status of a message."""
        config = self._config
        axes = odometry_messages.axes_of(message.frame_id, message.child_frame_id, config.body_axes)
        if axes is None or config.frame not in (None, odometry_messages.frame_name(message.frame_id)):
            return _NAN7, _NAN6, Status.PROTOCOL
        pose = odometry_messages.pose_of(message, axes)
        if not all(map(math.isfinite, pose)):
            return pose, _NAN6, Status.NOT_FINITE
        twist = odometry_messages.twist_of(message, axes, pose[3:])
        known = tuple(value for value in twist if not math.isnan(value))
        confidence = self._confidence(message.quality)
        return pose, twist, self._poses.status(pose, known, confidence, t_ns, host_ns, credible)

    def _confidence(self, quality: int) -> int:
        """The sender's percentage as 0 (failed) to 3 (high); an unknown quality counts as usable (2)."""
        if quality <= odometry_messages.FAILED:
            return 0
        if quality == odometry_messages.UNKNOWN_QUALITY:
            return USABLE_CONFIDENCE
        return 1 + (quality >= self._config.least_quality) + (quality >= self._config.good_quality)
