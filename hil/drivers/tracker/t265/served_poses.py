"""Receives an emulated camera's poses over UDP, in the shape of a librealsense pipeline.

It subscribes with one small datagram, renews that every 100 datagrams or after 0.1 s of silence, and passes
every pose to the callback from a thread of its own, as librealsense does. Settings and wheel odometry go the
same way. `hil.links.t265_datagrams` has the layout of the datagrams.
"""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from hil.drivers.tracker.t265.librealsense_interface import Frame
from hil.links.t265_datagrams import (
    FEED_HEAD,
    FEED_INFO,
    FEED_LEAVE,
    FEED_MAGIC,
    FEED_POSE,
    FEED_SETTINGS,
    FEED_SUBSCRIBE,
    FEED_WHEELS,
    INFO_RECORD,
    POSE_RECORD,
    WHEELS_RECORD,
)

_POLL_S = 0.1
_ASK_TIMES = 20
_RENEW_AFTER = 100
_LARGEST = 2048


class FeedFrame:
    """One received pose in the shape of a librealsense frame."""

    def __init__(self, fields: tuple[Any, ...]) -> None:
        self._fields = fields

    def is_pose_frame(self) -> bool:
        """True: a feed carries only poses."""
        return True

    def as_pose_frame(self) -> FeedFrame:
        """This object itself, as in the library."""
        return self

    def get_timestamp(self) -> float:
        """Milliseconds on the camera's time axis."""
        return float(self._fields[3])

    def get_frame_number(self) -> int:
        """Frame number of the camera."""
        return int(self._fields[2])

    def get_pose_data(self) -> SimpleNamespace:
        """The pose in the camera's axes."""
        f = self._fields
        return SimpleNamespace(
            translation=SimpleNamespace(x=f[4], y=f[5], z=f[6]),
            velocity=SimpleNamespace(x=f[7], y=f[8], z=f[9]),
            rotation=SimpleNamespace(x=f[10], y=f[11], z=f[12], w=f[13]),
            angular_velocity=SimpleNamespace(x=f[14], y=f[15], z=f[16]),
            tracker_confidence=f[17],
        )


class FeedDevice:
    """The camera's data from the feed, in the shape of a librealsense device and profile."""

    def __init__(self, record: bytes) -> None:
        _, _, *texts = INFO_RECORD.unpack(record)
        names = ("name", "serial_number", "firmware_version")
        self._info: dict[str, str] = {
            name: text.rstrip(b"\0").decode("utf-8", "replace")
            for name, text in zip(names, texts, strict=True)
        }

    def get_device(self) -> FeedDevice:
        """The device of this profile: the same object."""
        return self

    def supports(self, key: str) -> bool:
        """Whether the feed has sent this information."""
        return key in self._info

    def get_info(self, key: str) -> str:
        """Name, serial number or firmware version."""
        return self._info[key]


class FeedSensor:
    """Sends options and wheel odometry, in the shape of librealsense's sensor and wheel odometer."""

    def __init__(self, send: Callable[[bytes], bool]) -> None:
        self._send = send
        self._options: dict[str, float] = {}
        self._wheels: Any = None

    def query_sensors(self) -> list[FeedSensor]:
        """The sensors of this device: the same object."""
        return [self]

    def get_device(self) -> FeedSensor:
        """The device of this sensor: the same object."""
        return self

    def supports(self, option: str) -> bool:
        """True: the camera checks each option itself."""
        return True

    def set_option(self, option: str, value: float) -> None:
        """Set an option; sent when the stream starts."""
        self._options[option] = value

    def get_option(self, option: str) -> float:
        """The value that was set."""
        return self._options[option]

    def as_wheel_odometer(self) -> FeedSensor:
        """The wheel odometer of this sensor: the same object."""
        return self

    def load_wheel_odometery_config(self, calibration: list[int]) -> bool:
        """Set the mounts of the wheels; sent when the stream starts."""
        self._wheels = json.loads(bytes(calibration))
        return True

    def send_wheel_odometry(self, sensor: int, number: int, velocity: Any) -> bool:
        """Send a velocity of the wheels at once."""
        v = velocity
        return self._send(WHEELS_RECORD.pack(FEED_MAGIC, FEED_WHEELS, sensor, number, v.x, v.y, v.z))

    def settings(self) -> bytes:
        """The datagram of all options and mounts."""
        reported = {"options": self._options, "wheels": self._wheels}
        return FEED_HEAD.pack(FEED_MAGIC, FEED_SETTINGS) + json.dumps(reported).encode()


class FeedPipeline:
    """Same use as `pyrealsense2.pipeline`: `start` with a callback, `stop`.

    Args:
        host, port: address and UDP port of the emulated camera.

    Attributes:
        strange: datagrams from elsewhere or of another layout.
    """

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._socket: socket.socket | None = None
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self._sensor = FeedSensor(self._tell)
        self.strange = 0

    def resolve(self) -> FeedSensor:
        """The sensor that takes options before the stream starts."""
        return self._sensor

    def start(self, config: Any, callback: Callable[[Frame], None]) -> FeedDevice:
        """Subscribe; raises `RuntimeError` when no camera (of the requested serial number) answers."""
        self.stop()
        self._stopping.clear()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(_POLL_S)
        try:
            self._socket.connect(self._address)
            device = self._ask(self._socket)
            self._tell(self._sensor.settings())
            if config.serial not in (None, device.get_info("serial_number")):
                raise RuntimeError(f"the feed comes from camera {device.get_info('serial_number')}")
        except BaseException:
            self.stop()
            raise
        self._thread = threading.Thread(
            target=self._receive, args=(self._socket, callback), name="tracker-feed", daemon=True
        )
        self._thread.start()
        return device

    def stop(self) -> None:
        """Leave the feed. Idempotent."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.send(FEED_HEAD.pack(FEED_MAGIC, FEED_LEAVE))
            self._socket.close()
            self._socket = None

    def _ask(self, port: socket.socket) -> FeedDevice:
        for _ in range(_ASK_TIMES):
            data = self._exchange(port)
            if len(data) == INFO_RECORD.size and FEED_HEAD.unpack_from(data) == (FEED_MAGIC, FEED_INFO):
                return FeedDevice(data)
        raise RuntimeError("no emulated camera answers at {}:{}".format(*self._address))

    def _tell(self, data: bytes) -> bool:
        if self._socket is None:
            return False
        try:
            return self._socket.send(data) == len(data)
        except OSError:
            return False

    def _exchange(self, port: socket.socket) -> bytes:
        """Subscribe once; returns the next datagram, empty when there is none in time."""
        try:
            port.send(FEED_HEAD.pack(FEED_MAGIC, FEED_SUBSCRIBE))
            return port.recv(_LARGEST)
        except TimeoutError:
            return b""
        except ConnectionRefusedError:
            self._stopping.wait(_POLL_S)
            return b""

    def _receive(self, port: socket.socket, callback: Callable[[Frame], None]) -> None:
        received = 0
        while not self._stopping.is_set():
            try:
                if received % _RENEW_AFTER == 0:
                    port.send(FEED_HEAD.pack(FEED_MAGIC, FEED_SUBSCRIBE))
                data = port.recv(_LARGEST)
            except TimeoutError:
                received = 0
                continue
            except OSError:
                self._stopping.wait(_POLL_S)
                received = 0
                continue
            received += 1
            if len(data) == POSE_RECORD.size and data[:4] == FEED_HEAD.pack(FEED_MAGIC, FEED_POSE):
                callback(FeedFrame(POSE_RECORD.unpack(data)))
            elif len(data) != INFO_RECORD.size:
                self.strange += 1
