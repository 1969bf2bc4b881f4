"""The part of librealsense that the driver uses, as protocols, and where it comes from.

A real camera needs the extra `[t265]` with pyrealsense2 2.53.1, whose last wheels are for CPython
3.10: newer versions have lost the T265 (librealsense's release notes).
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any, Protocol

from hil.clock import Clock, nanoseconds
from hil.errors import DeviceError
from hil.extras import how_to_install

LAST_VERSION = "2.53.1"
VENDOR_ERRORS = (RuntimeError, OSError, TypeError, AttributeError)
"""What librealsense's binding raises; all of it is translated where it happens."""

_LOOK_NS = 200_000_000


class Frame(Protocol):
    """A frame as the library hands it to a callback."""

    def is_pose_frame(self) -> bool:
        """Whether it carries a pose."""

    def as_pose_frame(self) -> Any:
        """The same frame with `get_pose_data` (SI units, confidence 0 failed to 3 high)."""

    def get_timestamp(self) -> float:
        """Milliseconds on the device's time axis."""

    def get_frame_number(self) -> int:
        """Counts the frames of the stream."""


class Pipeline(Protocol):
    """What is used of `pyrealsense2.pipeline`.

    Poses are taken by callback: polling delivers the latest frame only and drops the others.
    """

    def start(self, config: Any, callback: Callable[[Frame], None]) -> Any:
        """Begin to stream; returns the profile, whose device knows its name and serial number."""

    def stop(self) -> None:
        """End the stream."""


class StreamRequest:
    """Stands in for `pyrealsense2.config` where a pipeline needs no library."""

    def __init__(self) -> None:
        self.streams: list[str] = []
        self.serial: str | None = None

    def enable_stream(self, stream: str) -> None:
        """Ask for a stream by name."""
        self.streams.append(stream)

    def enable_device(self, serial: str) -> None:
        """Ask for one camera by its serial number."""
        self.serial = serial


class _Streams:
    pose = "pose"


class _CameraInfo:
    name = "name"
    serial_number = "serial_number"
    firmware_version = "firmware_version"


class PlainLibrary:
    """The names of the library that go with a pipeline that is not librealsense's own."""

    config = StreamRequest
    stream = _Streams
    camera_info = _CameraInfo


def realsense(device: str) -> Any:
    """The module pyrealsense2; raises `DeviceError` with what to do when it cannot be imported."""
    try:
        return importlib.import_module("pyrealsense2")
    except ImportError as error:
        raise DeviceError(
            device,
            f"pyrealsense2 cannot be imported ({error})",
            expected=f"the extra t265 with pyrealsense2 {LAST_VERSION} on CPython 3.10 or older",
            remedy=f"{how_to_install('t265')}; and the system package libusb-1.0-0; or emulate the tracker",
        ) from None


def connected_context(library: Any, device: str, clock: Clock, timeout_s: float) -> Any:
    """A librealsense context that sees a device: a T265 first gets its firmware, which takes seconds.

    Raises:
        DeviceError: nothing is connected, or the library has no access.
    """
    deadline_ns = clock.now_ns() + nanoseconds(timeout_s)
    reason = "no RealSense device is connected"
    while clock.now_ns() < deadline_ns:
        try:
            context = library.context()
            if len(context.query_devices()) > 0:
                return context
        except VENDOR_ERRORS as error:
            reason = f"librealsense cannot be used ({error})"
        clock.sleep_until_ns(clock.now_ns() + _LOOK_NS)
    version = getattr(library, "__version__", "of unknown version")
    raise DeviceError(
        device,
        reason,
        expected=f"a T265 and pyrealsense2 {LAST_VERSION}; this is {version}",
        remedy="check the USB 3 cable and the udev rules of librealsense, or emulate the tracker",
    )
