"""The part of librealsense that the driver uses, as protocols, and the functions that load it.

A real camera needs the extra `[t265]` with pyrealsense2 2.53.1, whose last wheels are for CPython
3.10: newer versions have lost the T265 (librealsense's release notes).
"""

import importlib
from collections.abc import Callable
from typing import Any, Protocol

from hil.core.clock import Clock, nanoseconds
from hil.core.errors import DeviceError
from hil.support.extras import how_to_install
from hil.support.versions import ABSENT, version_of

MODEL = "T265"
LAST_VERSION, LAST_FIRMWARE = "2.53.1", "0.2.0.951"
VENDOR_ERRORS = (RuntimeError, OSError, TypeError, AttributeError)
"""Exceptions of librealsense's binding; all are translated where they occur."""

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
    """The part of `pyrealsense2.pipeline` that is used.

    Poses are taken by callback: polling delivers the latest frame only and drops the others.
    """

    def start(self, config: Any, callback: Callable[[Frame], None]) -> Any:
        """Begin to stream; returns the profile, whose device has a name and a serial number."""

    def stop(self) -> None:
        """End the stream."""


class StreamRequest:
    """Stands in for `pyrealsense2.config` where a pipeline needs no library."""

    def __init__(self) -> None:
        self.streams: list[str] = []
        self.serial: str | None = None

    def enable_stream(self, stream: str) -> None:
        """Request a stream by name."""
        self.streams.append(stream)

    def enable_device(self, serial: str) -> None:
        """Request one camera by its serial number."""
        self.serial = serial

    def resolve(self, pipeline: Any) -> Any:
        """The profile that the pipeline would start with: its device takes options."""
        return pipeline.resolve()


class _Streams:
    pose = "pose"


class _Options:
    enable_mapping = "enable_mapping"
    enable_relocalization = "enable_relocalization"
    enable_pose_jumping = "enable_pose_jumping"
    enable_map_preservation = "enable_map_preservation"


class _Vector:
    x = y = z = 0.0


class _CameraInfo:
    name = "name"
    serial_number = "serial_number"
    firmware_version = "firmware_version"


class PlainLibrary:
    """Replaces the library's names for a pipeline that is not librealsense's own."""

    config = StreamRequest
    stream = _Streams
    option = _Options
    vector = _Vector
    camera_info = _CameraInfo


def realsense(device: str) -> Any:
    """The module pyrealsense2; raises `DeviceError` with what to do when it cannot be imported."""
    try:
        return importlib.import_module("pyrealsense2")
    except (ImportError, OSError) as error:
        raise DeviceError(
            device,
            f"pyrealsense2 cannot be imported ({error})",
            expected=f"the extra t265 with pyrealsense2 {LAST_VERSION} on CPython 3.10 or older",
            remedy=f"{how_to_install('t265')}; and the system package libusb-1.0-0; or emulate the tracker",
        ) from None


def find_camera(
    library: Any, device: str, clock: Clock, timeout_s: float, *, serial: str | None = None
) -> tuple[Any, str]:
    """A pipeline on a connected T265, and that camera's serial number.

    The library loads the firmware of a T265, which takes seconds after it was plugged in: until then the
    library is polled.

    Args:
        library: the module pyrealsense2, or what stands in for it.
        device: name in errors.
        clock: the bench clock.
        timeout_s: longest search; the library is asked once in any case.
        serial: serial number that the camera must have; any when None.

    Raises:
        DeviceError: none is connected, or the library has no access.
    """
    deadline_ns = clock.now_ns() + nanoseconds(timeout_s)
    while True:
        try:
            context = library.context()
            seen = _cameras(library, context)
            for name, number in seen:
                if MODEL in name and serial in (None, number):
                    return library.pipeline(context), number
            others = ", ".join(f"{name} ({number})" for name, number in seen)
            wanted = MODEL if serial is None else f"{MODEL} with serial number {serial}"
            reason = f"no {wanted} is connected" + (f", but {others}" if others else "")
        except VENDOR_ERRORS as error:
            reason = f"librealsense cannot be used ({error})"
        if clock.now_ns() >= deadline_ns:
            break
        clock.sleep_until_ns(clock.now_ns() + _LOOK_NS)
    version = version_of("pyrealsense2").replace(ABSENT, "of unknown version")  # the library does not say
    raise DeviceError(
        device,
        reason,
        port=serial or "",
        expected=f"a T265 and pyrealsense2 {LAST_VERSION}; this is {version}",
        remedy="check the USB 3 cable and the udev rules of librealsense, or emulate the tracker",
    )


def identity_of(device: Any, library: Any, name: str) -> dict[str, str]:
    """Model, serial number and firmware of a camera; raises `DeviceError` for one that is no T265."""
    info = library.camera_info
    model, serial, firmware = (
        str(device.get_info(key)) if device.supports(key) else "unknown"
        for key in (info.name, info.serial_number, info.firmware_version)
    )
    if MODEL not in model:
        raise DeviceError(
            name,
            f"the camera is a {model}",
            port=serial,
            expected="a T265",
            remedy="set tracker.serial to the T265's serial number",
        )
    return {"model": model, "serial": serial, "firmware": firmware}


def _cameras(library: Any, context: Any) -> list[tuple[str, str]]:
    """Name and serial number of every RealSense device."""
    info = library.camera_info
    return [
        (str(one.get_info(info.name)), str(one.get_info(info.serial_number)))
        for one in context.query_devices()
        if one.supports(info.serial_number)
    ]
