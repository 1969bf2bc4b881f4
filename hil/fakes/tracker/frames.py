"""Librealsense's frame, device and pipeline as the emulated camera fills them in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from hil.fakes.tracker.odometry import CameraPose

MODEL = "Intel RealSense T265"


class PoseData:
    """As `rs.pose`: camera axes, world given by gravity and the first view."""

    def __init__(self, pose: CameraPose, confidence: int) -> None:
        self.translation, self.velocity, self.rotation, self.angular_velocity = pose
        self.tracker_confidence = self.mapper_confidence = confidence


@dataclass(frozen=True)
class PoseFrame:
    """One pose with its number and time stamp, as `rs.frame` and `rs.pose_frame` in one."""

    number: int
    timestamp_ms: float
    pose: CameraPose
    confidence: int

    def is_pose_frame(self) -> bool:
        """Yes."""
        return True

    def as_pose_frame(self) -> PoseFrame:
        """Itself."""
        return self

    def get_timestamp(self) -> float:
        """Milliseconds of the library's global time."""
        return self.timestamp_ms

    def get_frame_number(self) -> int:
        """Counts from the start of the stream."""
        return self.number

    def get_pose_data(self) -> PoseData:
        """The pose."""
        return PoseData(self.pose, self.confidence)


FrameCallback = Callable[[PoseFrame], None]


class Camera(Protocol):
    """What a pipeline needs of the camera behind it."""

    serial: str
    model: str
    firmware: str

    def start_stream(self, callback: FrameCallback) -> None:
        """Begin to deliver poses; raises `RuntimeError` as the library does."""

    def stop_stream(self, callback: FrameCallback) -> None:
        """Deliver no more to this callback."""


class DeviceInfo:
    """Device and profile in one: knows its name, serial number and firmware."""

    def __init__(self, camera: Camera) -> None:
        self._info = {
            "name": camera.model,
            "serial_number": camera.serial,
            "firmware_version": camera.firmware,
        }

    def get_device(self) -> DeviceInfo:
        """Itself."""
        return self

    def supports(self, key: str) -> bool:
        """Whether this is known."""
        return key in self._info

    def get_info(self, key: str) -> str:
        """Name, serial number or firmware version."""
        return self._info[key]


class WorldPipeline:
    """Stands in for `pyrealsense2.pipeline`: poses reach the callback as world time passes."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._callback: FrameCallback | None = None

    def start(self, config: Any, callback: FrameCallback) -> DeviceInfo:
        """Begin to stream; raises `RuntimeError` as the library does when no camera fits."""
        if self._callback is not None:
            raise RuntimeError("start() cannot be called before stop()")
        if config.serial not in (None, self._camera.serial):
            raise RuntimeError("Couldn't resolve requests")
        self._camera.start_stream(callback)
        self._callback = callback
        return DeviceInfo(self._camera)

    def stop(self) -> None:
        """End the stream; raises `RuntimeError` as the library does when there is none."""
        if self._callback is None:
            raise RuntimeError("stop() cannot be called before start()")
        self._camera.stop_stream(self._callback)
        self._callback = None
