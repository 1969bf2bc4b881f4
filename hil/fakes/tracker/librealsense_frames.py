"""Librealsense's frame, device and pipeline as the emulated camera fills them in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from hil.fakes.tracker.visual_odometry import CameraPose, Quaternion, Vector
from hil.fakes.tracker.wheel_odometer_input import WheelInput

MODEL = "Intel RealSense T265"


class PoseData(NamedTuple):
    """As `rs.pose`: camera axes, world given by gravity and the first view."""

    translation: Vector
    velocity: Vector
    rotation: Quaternion
    angular_velocity: Vector
    tracker_confidence: int
    mapper_confidence: int


class PoseFrame(NamedTuple):
    """One pose with its number and time stamp, as `rs.frame` and `rs.pose_frame` in one."""

    number: int
    timestamp_ms: float
    pose: CameraPose
    confidence: int

    def is_pose_frame(self) -> bool:
        """True: all frames of this camera are poses."""
        return True

    def as_pose_frame(self) -> PoseFrame:
        """This object itself, as in the library."""
        return self

    def get_timestamp(self) -> float:
        """Milliseconds of the library's global time."""
        return self.timestamp_ms

    def get_frame_number(self) -> int:
        """Counts from the start of the stream."""
        return self.number

    def get_pose_data(self) -> PoseData:
        """The pose data of this frame."""
        return PoseData(*self.pose, self.confidence, self.confidence)


FrameCallback = Callable[[PoseFrame], None]


class Camera(Protocol):
    """What a pipeline needs of the camera behind it."""

    serial: str
    model: str
    firmware: str
    settings: dict[str, float]
    wheels: WheelInput

    @property
    def now_ns(self) -> int:
        """World time, ns."""

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
        """This object itself, as in the library."""
        return self

    def supports(self, key: str) -> bool:
        """Whether this is known."""
        return key in self._info

    def get_info(self, key: str) -> str:
        """Name, serial number or firmware version."""
        return self._info[key]


class WorldSensor:
    """The camera's settings and wheel odometer, as `rs.sensor` and `rs.wheel_odometer` in one."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera

    def get_device(self) -> WorldSensor:
        """Itself: profile, device and sensor in one."""
        return self

    def query_sensors(self) -> list[WorldSensor]:
        """This object itself, as in the library."""
        return [self]

    def supports(self, option: str) -> bool:
        """Whether the camera has such a setting."""
        return option in self._camera.settings

    def set_option(self, option: str, value: float) -> None:
        """Raises `RuntimeError` as the library does for an option that the camera does not have."""
        if option not in self._camera.settings:
            raise RuntimeError("object doesn't support option")
        self._camera.settings[option] = value

    def get_option(self, option: str) -> float:
        """As it is set."""
        return self._camera.settings[option]

    def as_wheel_odometer(self) -> WorldSensor:
        """This object itself, as in the library."""
        return self

    def load_wheel_odometery_config(self, calibration: list[int]) -> bool:
        """Whether it was a calibration."""
        return self._camera.wheels.load(bytes(calibration))

    def send_wheel_odometry(self, sensor: int, number: int, velocity: Any) -> bool:
        """Whether the velocity could be one."""
        v = velocity.x, velocity.y, velocity.z
        return self._camera.wheels.send(sensor, number, v, self._camera.now_ns)


class WorldPipeline:
    """Stands in for `pyrealsense2.pipeline`: poses reach the callback as world time passes."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._callback: FrameCallback | None = None

    def resolve(self) -> WorldSensor:
        """The sensor that takes options before the stream starts."""
        return WorldSensor(self._camera)

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
