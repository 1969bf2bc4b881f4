"""Frame, device and pipeline of librealsense, as provided by the emulated camera."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from hil.fakes.tracker.t265.wheel_odometer_input import WheelInput
from hil.fakes.tracker.visual_odometry import CameraPose, Quaternion, Vector

MODEL = "Intel RealSense T265"


class PoseData(NamedTuple):
    """Like `rs.pose`: camera axes; the world is defined by gravity and the first view."""

    translation: Vector
    velocity: Vector
    rotation: Quaternion
    angular_velocity: Vector
    tracker_confidence: int
    mapper_confidence: int


class PoseFrame(NamedTuple):
    """One pose with its number and time stamp: `rs.frame` and `rs.pose_frame` in one."""

    number: int
    timestamp_ms: float
    pose: CameraPose
    confidence: int

    def is_pose_frame(self) -> bool:
        """True: all frames of this camera are poses."""
        return True

    def as_pose_frame(self) -> PoseFrame:
        """Return this object, as in the library."""
        return self

    def get_timestamp(self) -> float:
        """Time stamp in milliseconds of the library's global time."""
        return self.timestamp_ms

    def get_frame_number(self) -> int:
        """Frame number from the start of the stream."""
        return self.number

    def get_pose_data(self) -> PoseData:
        """The pose data of this frame."""
        return PoseData(*self.pose, self.confidence, self.confidence)


FrameCallback = Callable[[PoseFrame], None]


class Camera(Protocol):
    """Interface of a camera for its pipelines."""

    serial: str
    model: str
    firmware: str
    settings: dict[str, float]
    wheels: WheelInput

    @property
    def now_ns(self) -> int:
        """World time, ns."""

    def start_stream(self, callback: FrameCallback) -> None:
        """Start delivering poses; raises `RuntimeError` as the library does."""

    def stop_stream(self, callback: FrameCallback) -> None:
        """Stop delivering poses to this callback."""


class DeviceInfo:
    """Device and profile in one: name, serial number and firmware."""

    def __init__(self, camera: Camera) -> None:
        self._info = {
            "name": camera.model,
            "serial_number": camera.serial,
            "firmware_version": camera.firmware,
        }

    def get_device(self) -> DeviceInfo:
        """Return this object, as in the library."""
        return self

    def supports(self, key: str) -> bool:
        """Return whether this information is available."""
        return key in self._info

    def get_info(self, key: str) -> str:
        """Name, serial number or firmware version."""
        return self._info[key]


class WorldSensor:
    """Settings and wheel odometer of the camera: `rs.sensor` and `rs.wheel_odometer` in one."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera

    def get_device(self) -> WorldSensor:
        """Return this object: profile, device and sensor in one."""
        return self

    def query_sensors(self) -> list[WorldSensor]:
        """Return this object in a list, as in the library."""
        return [self]

    def supports(self, option: str) -> bool:
        """Return whether the camera has this setting."""
        return option in self._camera.settings

    def set_option(self, option: str, value: float) -> None:
        """Set an option; raises `RuntimeError` as the library does for an unknown one."""
        if option not in self._camera.settings:
            raise RuntimeError("object doesn't support option")
        self._camera.settings[option] = value

    def get_option(self, option: str) -> float:
        """Return the value of an option."""
        return self._camera.settings[option]

    def as_wheel_odometer(self) -> WorldSensor:
        """Return this object, as in the library."""
        return self

    def load_wheel_odometery_config(self, calibration: list[int]) -> bool:
        """Load a calibration; returns whether it is valid."""
        return self._camera.wheels.load(bytes(calibration))

    def send_wheel_odometry(self, sensor: int, number: int, velocity: Any) -> bool:
        """Send a velocity; returns whether it is valid."""
        v = velocity.x, velocity.y, velocity.z
        return self._camera.wheels.send(sensor, number, v, self._camera.now_ns)


class WorldPipeline:
    """Replaces `pyrealsense2.pipeline`: poses reach the callback as world time passes."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._callback: FrameCallback | None = None

    def resolve(self) -> WorldSensor:
        """Return the sensor, for setting options before the stream starts."""
        return WorldSensor(self._camera)

    def start(self, config: Any, callback: FrameCallback) -> DeviceInfo:
        """Start streaming; raises `RuntimeError` as the library does if no camera matches."""
        if self._callback is not None:
            raise RuntimeError("start() cannot be called before stop()")
        if config.serial not in (None, self._camera.serial):
            raise RuntimeError("Couldn't resolve requests")
        self._camera.start_stream(callback)
        self._callback = callback
        return DeviceInfo(self._camera)

    def stop(self) -> None:
        """Stop streaming; raises `RuntimeError` as the library does if it has not started."""
        if self._callback is None:
            raise RuntimeError("stop() cannot be called before start()")
        self._camera.stop_stream(self._callback)
        self._callback = None
