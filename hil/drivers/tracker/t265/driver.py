"""Driver of the T265: poses from the library's thread, on the bench clock, with a status.

Camera axes are x right, y up, z back; robot axes are x forward, y left, z up, so that
(x, y, z) = (-z, -x, y) of the camera, for vectors and for the vector part of a quaternion, both of
the pose and of the world it is given in (librealsense's documentation of the T265 shows the camera's axes).
Velocities are in the axes of that world, as the library gives them.
"""

import logging
import math
import struct
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from hil.config.tracker import T265Config
from hil.core.clock import Clock, nanoseconds
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.interfaces import Sensor
from hil.core.signals import Stamp, TrackerSample
from hil.drivers.tracker.t265.librealsense_interface import (
    VENDOR_ERRORS,
    Frame,
    Pipeline,
    PlainLibrary,
    find_camera,
    identity_of,
    realsense,
)
from hil.drivers.tracker.t265.served_poses import FeedPipeline
from hil.drivers.tracker.t265.settings import WheelVelocities, apply_settings
from hil.links.injection import faulty_callback, with_faults
from hil.streams.pose_stream import WITHOUT_POSE, PoseStream
from hil.streams.silence_limit import USELESS, SilenceTimer, nothing_usable, used_while_closed

_LOG = logging.getLogger(__name__)

_WAIT_NS = 5_000_000
_NS_PER_MS = 1e6
_LATEST_MS = 5e12
_RESTART_FRAMES = 200
_floats, _DOUBLES = np.frombuffer, struct.Struct("13d").pack

_Raw = tuple[Any, ...]
"""Arrival in ns, number, milliseconds on the device's axis, confidence; position, attitude, velocity and rate
in robot axes."""


class T265Tracker(Sensor[TrackerSample]):
    """One T265.

    Args:
        config: serial number of the camera, and limits for its poses.
        clock: the bench clock; the library's thread reads it too.
        pipeline: an object with the shape of `pyrealsense2.pipeline`; by default the configured
            feed of an emulated camera, else the library's own pipeline.
        library: the module that the pipeline belongs to, where that is librealsense.

    Attributes:
        overflowed: poses lost between two reads since `open`.
        repeated: poses passed over because their number was not new.
        malformed: frames that carried no pose or could not be read.
    """

    name = "tracker"

    def __init__(
        self, config: T265Config, clock: Clock, pipeline: Pipeline | None = None, library: Any = None
    ) -> None:
        self._config, self._clock = config, clock
        self._given, self._library = pipeline, library
        self._running: Pipeline | None = None
        self._wheels: WheelVelocities | None = None
        self._identity: dict[str, str] = {}
        self._queue: deque[_Raw] = deque(maxlen=config.queue_length)
        self._poses = PoseStream(config, config.latency_s)
        self._silence_timer = SilenceTimer(config.fail_after_s)
        self.overflowed = self.repeated = self.malformed = 0
        self._number, self._seq_base, self._resumed_at = -1, 0, 0

    def open(self) -> None:
        """Start the pose stream, check identity and wait for the first pose.

        Raises:
            DeviceTimeoutError: the camera sends no poses.
            DeviceError: the library is missing, no T265 is connected, or it is another camera.
        """
        self.close()
        self._forget()
        pipeline, library = self._choose()
        self._running = pipeline
        try:
            self._identity = self._start(pipeline, library)
            self._await_first()
        except BaseException:
            self.close()
            raise
        self._silence_timer.begin(self._clock.now_ns())

    def reopen(self) -> None:
        """Open again after an outage: sample numbers go on, and the first usable pose has status RESET."""
        self._resumed_at = max(self._resumed_at, self._seq_base + self._number + 1)
        self.open()
        self._seq_base = self._resumed_at - int(self._queue[0][1])
        self._poses.begin_again()

    port_gone = False  # USB reports it to the library, which does not pass it on

    def close(self) -> None:
        """Stop the stream. Idempotent; never raises."""
        self._identity = {}
        wheels, self._wheels = self._wheels, None
        if wheels is not None:
            wheels.close()
        if self._running is not None:
            pipeline, self._running = self._running, None
            try:
                pipeline.stop()
            except VENDOR_ERRORS as error:
                _LOG.debug("%s: the pipeline did not stop cleanly (%s)", self.name, error)

    def identity(self) -> Mapping[str, str]:
        """Model, serial number and firmware of the camera; empty while closed."""
        return self._identity

    def read(self) -> tuple[TrackerSample, ...]:
        """All poses since the last call, oldest first.

        Raises:
            DeviceError: it is closed.
            DeviceTimeoutError: no usable pose for `fail_after_s`.
        """
        if self._running is None:
            raise used_while_closed(self.name, self._port)
        queue = self._queue
        samples: list[TrackerSample] = []
        useful = False
        for _ in range(len(queue)):
            sample = self._sample(queue.popleft())
            if sample is not None:
                samples.append(sample)
                useful = useful or sample.status not in USELESS
        now_ns = self._clock.now_ns()
        if overdue_ns := self._silence_timer.overdue_ns(useful, now_ns):
            raise self._silent(overdue_ns, samples)
        return tuple(samples)

    def take_wheel_velocity(self, v_x_m_s: float, v_y_m_s: float) -> None:
        """Send the camera the velocity of the body's origin by the wheels, body axes; never waits."""
        if self._wheels is not None:
            self._wheels.take(v_x_m_s, v_y_m_s)

    @property
    def _port(self) -> str:
        endpoint = self._config.endpoint
        return self._config.serial or "" if endpoint is None else f"{endpoint.host}:{endpoint.port}"

    def _forget(self) -> None:
        self._queue.clear()
        self.overflowed = self.repeated = self.malformed = 0
        self._number = -1
        self._seq_base = 0
        self._timestamp_ms = -math.inf
        self._poses.begin(self._clock.now_ns())

    def _choose(self) -> tuple[Pipeline, Any]:
        """The pipeline to run and the library module that belongs to it."""
        if self._given is not None:
            return self._given, PlainLibrary if self._library is None else self._library
        if self._config.endpoint is not None:
            endpoint = self._config.endpoint
            return FeedPipeline(endpoint.host, endpoint.port), PlainLibrary
        library = realsense(self.name)
        limit_s, serial = self._config.connect_timeout_s, self._config.serial
        pipeline, _ = find_camera(library, self.name, self._clock, limit_s, serial=serial)
        return pipeline, library

    def _start(self, pipeline: Pipeline, library: Any) -> dict[str, str]:
        serial = self._config.serial
        try:
            request = library.config()
            request.enable_stream(library.stream.pose)
            if serial is not None:
                request.enable_device(serial)
            there = request.resolve(pipeline).get_device()
            in_real_time = self._clock.wall_offset() is not None
            self._wheels = apply_settings(there, library, self._config, self.name, beside=in_real_time)
            device = pipeline.start(request, with_faults(self._take, faulty_callback)).get_device()
            found = identity_of(device, library, self.name)
        except DeviceError:
            raise
        except VENDOR_ERRORS as error:
            raise DeviceError(
                self.name,
                f"the pose stream cannot be started ({error})",
                port=self._port,
                expected="a T265" if serial is None else f"a T265 with serial number {serial}",
                remedy="check the USB 3 cable and that no other program uses the camera",
            ) from None
        return {**found, "port": self._port or "USB"}

    def _await_first(self) -> None:
        start_ns = self._clock.now_ns()
        while not self._queue:
            now_ns = self._clock.now_ns()
            if now_ns - start_ns > nanoseconds(self._config.open_timeout_s):
                raise self._silent(now_ns - start_ns, [])
            self._clock.sleep_until_ns(now_ns + _WAIT_NS)

    def _silent(self, silent_ns: int, samples: list[TrackerSample]) -> DeviceTimeoutError:
        return DeviceTimeoutError(
            self.name,
            nothing_usable("pose", silent_ns, samples),
            port=self._port,
            expected="200 poses per second",
            remedy=self._start_again(),
        )

    def _start_again(self) -> str:
        """What starts a silent camera again: an emulated one has no cable."""
        again = "close and open the tracker to start it again"
        return again if self._config.backend == "emulated" else f"check the USB 3 cable and power; {again}"

    def _take(self, frame: Frame) -> None:
        """Called by the library's thread with every frame: copy its numbers and release it."""
        host_ns = self._clock.now_ns()
        try:
            if not frame.is_pose_frame():
                self.malformed += 1
                return
            data = frame.as_pose_frame().get_pose_data()
            p, v, q, w = data.translation, data.velocity, data.rotation, data.angular_velocity
            raw = (
                host_ns,
                frame.get_frame_number(),
                frame.get_timestamp(),
                data.tracker_confidence,
                -p.z,
                -p.x,
                p.y,
                q.w,
                -q.z,
                -q.x,
                q.y,
                -v.z,
                -v.x,
                v.y,
                -w.z,
                -w.x,
                w.y,
            )
        except VENDOR_ERRORS:
            self.malformed += 1
            return
        queue = self._queue
        if len(queue) == queue.maxlen:
            self.overflowed += 1
        queue.append(raw)

    def _sample(self, raw: _Raw) -> TrackerSample | None:
        """The sample of one pose; None when its number is not new."""
        host_ns, number, timestamp_ms, confidence = raw[:4]
        if number <= self._number:
            if timestamp_ms <= self._timestamp_ms and self._number - number <= _RESTART_FRAMES:
                self.repeated += 1
                return None
            self._begin_again(number)
        self._number, self._timestamp_ms = number, timestamp_ms
        device_ns, t_ns, credible = None, host_ns, abs(timestamp_ms) < _LATEST_MS
        if credible:
            device_ns = round(timestamp_ms * _NS_PER_MS)
            t_ns, credible = self._poses.clock_map.map(device_ns, host_ns)
        status = self._poses.status(raw[4:11], raw[11:], confidence, t_ns, host_ns, credible)
        values = _floats(bytearray(_DOUBLES(*raw[4:])))
        if status in WITHOUT_POSE:
            values[:] = np.nan
        stamp = Stamp(t_ns, host_ns, self._seq_base + number, device_ns)
        return TrackerSample(stamp, values[0:3], values[3:7], values[7:10], values[10:13], confidence, status)

    def _begin_again(self, number: int) -> None:
        """Handle a restart: numbers and pose frame begin anew, and the next usable pose has status RESET."""
        _LOG.warning("%s has started again", self.name)
        self._seq_base += self._number + 1 - number
        self._poses.begin_again()
