"""Streams the emulated camera's poses over loopback UDP to any client that subscribes.

`hil.links.t265_datagrams` defines the datagrams; the driver's `FeedPipeline` is one of the clients.
"""

import json

from hil.core.clock import nanoseconds
from hil.core.errors import DeviceError
from hil.fakes.tracker.t265.chip import T265
from hil.fakes.tracker.t265.librealsense_frames import PoseFrame
from hil.fakes.udp_server import DatagramTransport
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

_FORGET_NS = nanoseconds(5.0)
_LARGEST = 2048
_HEAD_SUBSCRIBE = FEED_HEAD.pack(FEED_MAGIC, FEED_SUBSCRIBE)
_HEAD_SETTINGS = FEED_HEAD.pack(FEED_MAGIC, FEED_SETTINGS)
_HEAD_WHEELS = FEED_HEAD.pack(FEED_MAGIC, FEED_WHEELS)
_HEAD_LEAVE = FEED_HEAD.pack(FEED_MAGIC, FEED_LEAVE)


class TrackerTransport(DatagramTransport):
    """One camera on one UDP port.

    Args:
        camera: the emulated camera.
        host, port: address and UDP port to listen at; port 0 takes a free one.

    Attributes:
        strange: number of datagrams with another layout.

    Raises:
        DeviceError: the port cannot be used.
    """

    def __init__(self, camera: T265, *, host: str = "127.0.0.1", port: int = 0) -> None:
        self._camera = camera
        self._clients: dict[tuple[str, int], int] = {}
        self.strange = 0
        try:
            super().__init__(host, port)
        except OSError as error:
            raise DeviceError(
                camera.name,
                f"the emulated camera cannot be served ({error})",
                port=f"{host}:{port}",
                expected="a free UDP port",
                remedy="choose another one",
            ) from None

    def on_readable(self, fd: int, t_ns: int) -> None:
        """Handle one request: subscribe (answered with the identity), leave, settings or wheel velocity."""
        taken = self.receive(_LARGEST)
        if taken is None:
            return
        data, client = taken
        if data == _HEAD_LEAVE:
            self._forget(client)
        elif data == _HEAD_SUBSCRIBE:
            self._subscribe(client, t_ns)
        elif len(data) == WHEELS_RECORD.size and data.startswith(_HEAD_WHEELS):
            sensor, number, *velocity = WHEELS_RECORD.unpack(data)[2:]
            self._camera.wheels.send(sensor, number, (velocity[0], velocity[1], velocity[2]), t_ns)
        elif not (data.startswith(_HEAD_SETTINGS) and self._set(data[len(_HEAD_SETTINGS) :])):
            self.strange += 1

    def _set(self, data: bytes) -> bool:
        """Apply settings given as JSON; returns whether they are valid."""
        try:
            given = json.loads(data)
            options = {str(key): float(value) for key, value in given["options"].items()}
            wheels = given["wheels"]
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return False
        if not set(options) <= set(self._camera.settings):
            return False
        self._camera.settings.update(options)
        return wheels is None or self._camera.wheels.load(json.dumps(wheels).encode())

    def endpoint(self) -> dict[str, object]:
        """Address and serial number of the camera."""
        return {"host": self.host, "port": self.port, "serial": self._camera.serial}

    def close(self) -> None:
        """Stop streaming. Idempotent."""
        self._camera.stop_stream(self._pass_on)
        self._clients.clear()
        super().close()

    def _subscribe(self, client: tuple[str, int], t_ns: int) -> None:
        if client not in self._clients and not self._camera.streams_to(self._pass_on):
            try:
                self._camera.start_stream(self._pass_on)
            except RuntimeError:
                return
        self._clients[client] = t_ns
        texts = (self._camera.model, self._camera.serial, self._camera.firmware)
        record = INFO_RECORD.pack(FEED_MAGIC, FEED_INFO, *(text.encode()[:32] for text in texts))
        self.transmit(record, client)

    def _pass_on(self, frame: PoseFrame) -> None:
        pose = frame.pose
        record = POSE_RECORD.pack(
            FEED_MAGIC,
            FEED_POSE,
            frame.number,
            frame.timestamp_ms,
            *pose.translation,
            *pose.velocity,
            *pose.rotation_xyzw,
            *pose.angular_velocity,
            frame.confidence,
        )
        now_ns = self._camera.now_ns
        for client, seen_ns in tuple(self._clients.items()):
            if now_ns - seen_ns > _FORGET_NS:
                self._forget(client)
            else:
                self.transmit(record, client)

    def _forget(self, client: tuple[str, int]) -> None:
        """Remove a client; without clients the camera stops."""
        self._clients.pop(client, None)
        if not self._clients:
            self._camera.stop_stream(self._pass_on)
