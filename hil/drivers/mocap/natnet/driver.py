"""Driver of OptiTrack motion capture: one rigid body, on the bench clock, in a z-up frame, with a status."""

import logging
import math
from collections.abc import Mapping

import numpy as np

from hil.config.mocap import MocapConfig
from hil.core.clock import NS_PER_S, Clock, nanoseconds
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.interfaces import Sensor
from hil.core.signals import MocapSample, Stamp, Status
from hil.drivers.mocap.natnet.handshake import Handshake
from hil.drivers.mocap.natnet.messages import BodyPose, Frame
from hil.drivers.mocap.natnet.session import Session
from hil.links.udp_ports import DatagramFactory, udp_ports
from hil.streams.pose_stream import USABLE_CONFIDENCE, WITHOUT_POSE, PoseStream
from hil.streams.silence_limit import USELESS, SilenceTimer, nothing_usable, used_while_closed

_LOG = logging.getLogger(__name__)

_LONGEST_UP_S, _LONGEST_LATENCY_S = 5_000_000_000, 10
_array = np.array  # a name of this module: looking it up in numpy takes longer
_NAN7 = (math.nan,) * 7
_REMEDY = (
    "check that Motive streams (rigid bodies on, the right interface, unicast or multicast as configured) "
    "and that no firewall closes UDP 1510 and 1511"
)


class NatNetMocap(Sensor[MocapSample]):
    """One rigid body of a capture system.

    Args:
        config: addresses, body, axes, limits.
        clock: the bench clock.
        datagrams: function that opens UDP ports; real ones by default.
    """

    name = "mocap"

    def __init__(self, config: MocapConfig, clock: Clock, datagrams: DatagramFactory | None = None) -> None:
        self._config, self._clock = config, clock
        self._datagrams = datagrams
        self._session: Session | None = None
        self._identity: dict[str, str] = {}
        self._poses = PoseStream(config, config.transit_s)
        self._y_up = config.up_axis == "y"
        self._reconnect_ns = nanoseconds(config.reconnect_after_s)
        self._silence_timer = SilenceTimer(config.fail_after_s)
        self._seq_base, self._number, self._resumed_at = 0, -1, 0

    @property
    def counts(self) -> Mapping[str, int]:
        """Packets not used since `open`: malformed, of other senders, repeated, lost unread; and floods."""
        session = self._session
        names = ("malformed", "strangers", "repeated", "overflowed", "floods")
        return {name: 0 if session is None else getattr(session, name) for name in names}

    def open(self) -> None:
        """Find the server, the bit stream and the body, and wait for a first frame.

        Raises:
            DeviceTimeoutError: no server answers, or it sends no frames.
            DeviceError: the ports cannot be used, the version is unknown, or the body does not exist.
        """
        self.close()
        self._seq_base = 0
        self._number = -1
        now_ns = self._clock.now_ns()
        self._poses.begin(now_ns)
        deadline_ns = now_ns + nanoseconds(self._config.open_timeout_s)
        try:
            self._session = session = self._open_session()
            handshake = Handshake(session, self._config, self._clock, self.name, self._silent)
            server, first = handshake.run(deadline_ns)
            self._sample(*first)
        except BaseException:
            self.close()
            raise
        self._heard_ns = self._clock.now_ns()
        self._silence_timer.begin(self._heard_ns)
        self._identity = {
            "model": server.application,
            "version": server.application_version,
            "natnet": "{}.{}".format(*session.version),
            "body": f"{self._config.body} (id {session.body_id})",
            "port": self._port,
        }

    def reopen(self) -> None:
        """Open again after an outage: sample numbers go on."""
        self._resumed_at = max(self._resumed_at, self._seq_base + self._number)
        self.open()
        self._seq_base = max(0, self._resumed_at - self._number)

    port_gone = False  # a silent network looks like a silent server

    def close(self) -> None:
        """Close the ports. Idempotent; never raises."""
        self._identity = {}
        if self._session is not None:
            self._session.close()
            self._session = None

    def identity(self) -> Mapping[str, str]:
        """Server application, NatNet version and body; empty while closed."""
        return self._identity

    def read(self) -> tuple[MocapSample, ...]:
        """One sample per new frame since the last call, oldest first.

        Raises:
            DeviceError: it is closed.
            DeviceTimeoutError: no usable frame for `fail_after_s`.
        """
        session = self._session
        if session is None:
            raise used_while_closed(self.name, self._port)
        samples, useful = [], False
        for found in session.frames():
            sample = self._sample(*found)
            samples.append(sample)
            useful = useful or sample.status not in USELESS
        now_ns = self._clock.now_ns()
        session.keep_alive(now_ns)
        if samples:
            self._heard_ns = now_ns
        elif now_ns - self._heard_ns > self._reconnect_ns:
            self._heard_ns = now_ns
            session.connect()
        if overdue_ns := self._silence_timer.overdue_ns(useful, now_ns):
            raise self._silent(nothing_usable("frame", overdue_ns, samples))
        return tuple(samples)

    @property
    def _port(self) -> str:
        config = self._config
        group = f" group {config.multicast}" if config.multicast is not None else ""
        return f"{config.server}:{config.command_port}{group}"

    def _silent(self, message: str) -> DeviceTimeoutError:
        counts = ", ".join(f"{count} {name}" for name, count in self.counts.items() if count)
        return DeviceTimeoutError(
            self.name,
            message + (f", packets passed over: {counts}" if counts else ""),
            port=self._port,
            expected="frames of a NatNet 3 or 4 server",
            remedy=_REMEDY,
        )

    def _open_session(self) -> Session:
        datagrams = self._datagrams
        if datagrams is None:
            datagrams = udp_ports(self._clock, self._interface())
        try:
            return Session(self._config, self._clock, datagrams)
        except OSError as error:
            raise DeviceError(
                self.name,
                f"the UDP ports cannot be used ({error})",
                port=self._port,
                expected="a local interface and, for multicast, a data port that can be shared",
                remedy="check mocap.local_address, mocap.multicast and mocap.data_port",
            ) from None

    def _interface(self) -> str:
        """Local interface; a server on this host is reached through the loopback."""
        if self._config.local_address is not None:
            return self._config.local_address
        return "127.0.0.1" if self._config.server.startswith("127.") else ""

    def _sample(self, frame: Frame, arrived_ns: int, restarted: bool) -> MocapSample:
        """The sample of one frame."""
        if restarted:
            _LOG.warning("%s has started again", self.name)
            self._seq_base += self._number + 1 - frame.number
            self._poses.clock_map.reset()
            self._poses.begin_again()
        self._number = frame.number
        stamp, credible, latency_s = self._stamp(frame, arrived_ns)
        body = frame.body
        pose = _NAN7 if body is None else self._z_up(body)
        status = Status.NOT_TRACKED
        if body is not None and body.tracked:
            status = self._poses.status(pose, (), USABLE_CONFIDENCE, stamp.t_ns, arrived_ns, credible)
        if status in WITHOUT_POSE:
            pose = _NAN7
        values = _array(pose)
        tracked, error_m = (False, math.nan) if body is None else (body.tracked, body.marker_error_m)
        return MocapSample(stamp, values[:3], values[3:], tracked, latency_s, error_m, status)

    def _stamp(self, frame: Frame, arrived_ns: int) -> tuple[Stamp, bool, float]:
        """Stamp of the exposure, whether it is credible, and the latency from exposure to sending, s."""
        assert self._session is not None
        assert self._session.server is not None
        clock_hz = self._session.server.clock_hz
        exposed, sent = frame.exposure_ticks, frame.sent_ticks
        seq = self._seq_base + frame.number
        if 0 < exposed <= sent < clock_hz * _LONGEST_UP_S and sent - exposed < clock_hz * _LONGEST_LATENCY_S:
            sent_ns, exposed_ns = sent * NS_PER_S // clock_hz, exposed * NS_PER_S // clock_hz
            latency_s = (sent - exposed) / clock_hz
        else:
            credible_s = frame.timestamp_s if abs(frame.timestamp_s) < _LONGEST_UP_S else 0.0
            sent_ns = exposed_ns = round(credible_s * NS_PER_S)
            latency_s = math.nan
        t_ns, credible = self._poses.clock_map.map(sent_ns, arrived_ns)
        t_ns -= sent_ns - exposed_ns
        return Stamp(t_ns, arrived_ns, seq, exposed_ns), credible, latency_s

    def _z_up(self, body: BodyPose) -> tuple[float, ...]:
        """Position and quaternion (w first) with z out of the ground plane."""
        x, y, z = body.position_m
        qx, qy, qz, qw = body.rotation_xyzw
        if self._y_up:
            return x, -z, y, qw, qx, -qz, qy
        return x, y, z, qw, qx, qy, qz
