"""The emulated camera behind librealsense itself: poses go through the library's software device.

With pyrealsense2 of any version the driver then runs on an unchanged `pyrealsense2.pipeline`: its threads,
its frame objects, its profile. Real time only: the library delivers when its own threads get to it.
"""

from __future__ import annotations

from typing import Any

from hil.fakes.tracker.t265.chip import RATE_HZ, SETTINGS, T265
from hil.fakes.tracker.t265.librealsense_frames import PoseFrame

_STREAM_UID = 1


class SoftwareT265:
    """One emulated camera as a librealsense device in a context of its own.

    Args:
        camera: the emulated camera; it streams from now on.
        library: the module pyrealsense2.
    """

    def __init__(self, camera: T265, library: Any) -> None:
        rs = self.library = library
        self._camera = camera
        self._device = rs.software_device()
        for key, text in (
            (rs.camera_info.name, camera.model),
            (rs.camera_info.serial_number, camera.serial),
            (rs.camera_info.firmware_version, camera.firmware),
        ):
            self._device.register_info(key, text)
        self._sensor = self._device.add_sensor("Tracking Module")
        stream = rs.pose_stream()
        stream.type, stream.index, stream.uid = rs.stream.pose, 0, _STREAM_UID
        stream.fps, stream.fmt = round(RATE_HZ), rs.format.six_dof
        self._profile = rs.pose_stream_profile(self._sensor.add_pose_stream(stream))
        switch = rs.option_range()
        switch.min, switch.max, switch.step, switch.default = 0.0, 1.0, 1.0, 1.0
        for name in SETTINGS:
            self._sensor.add_option(getattr(rs.option, name), switch, True)
        self._context = rs.context()
        self._announced: list[Any] = []  # held: a device vanishes from the context with its last reference
        self._context.set_devices_changed_callback(
            lambda info: self._announced.append(info.get_new_devices())
        )
        self._device.add_to(self._context)
        camera.start_stream(self._inject)

    def option(self, name: str) -> float:
        """What the library was last given of one of the camera's settings."""
        return float(self._sensor.get_option(getattr(self.library.option, name)))

    def pipeline(self) -> Any:
        """A `pyrealsense2.pipeline` that finds this camera."""
        return self.library.pipeline(self._context)

    def close(self) -> None:
        """Stop feeding the library. Idempotent."""
        self._camera.stop_stream(self._inject)

    def _inject(self, frame: PoseFrame) -> None:
        rs, pose = self.library, frame.pose
        data = rs.pose()
        data.translation, data.velocity = self._vector(*pose.translation), self._vector(*pose.velocity)
        data.angular_velocity = self._vector(*pose.angular_velocity)
        data.acceleration = data.angular_acceleration = self._vector(0.0, 0.0, 0.0)
        rotation = rs.quaternion()
        rotation.x, rotation.y, rotation.z, rotation.w = pose.rotation_xyzw
        data.rotation = rotation
        data.tracker_confidence = data.mapper_confidence = frame.confidence
        out = rs.software_pose_frame()
        out.data, out.profile = data, self._profile
        out.timestamp, out.frame_number = frame.timestamp_ms, frame.number
        out.domain = rs.timestamp_domain.global_time
        self._sensor.on_pose_frame(out)

    def _vector(self, x: float, y: float, z: float) -> Any:
        vector = self.library.vector()
        vector.x, vector.y, vector.z = x, y, z
        return vector
