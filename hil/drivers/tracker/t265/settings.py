"""The settings of a T265 before and while it streams: map handling, wheel odometry.

The velocity is that of the body's origin in the body's axes. Where these are is set once, in librealsense's
JSON (its manual of the T265): `T` and `W` are place and rotation vector of the velocity sensor's frame in the
camera's axes, `noise_variance` the variance of a velocity, (m/s)^2.
"""

from __future__ import annotations

import json
import queue
import threading
from typing import Any

import numpy as np

from hil.config.tracker import T265Config
from hil.core.errors import DeviceError
from hil.core.geometry import quat_rotate
from hil.drivers.tracker.t265.librealsense_interface import LAST_FIRMWARE, LAST_VERSION, VENDOR_ERRORS

OPTIONS = {
    "mapping": "enable_mapping",
    "relocalisation": "enable_relocalization",
    "pose_jumping": "enable_pose_jumping",
    "map_preservation": "enable_map_preservation",
}
"""librealsense's names, by key of the table."""
_CAMERA_FROM_ROBOT = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
_SIGMA_M_S = 0.005
_UNUSED_VARIANCE = {"T_variance": [1e-6] * 3, "W_variance": [1e-4] * 3}
_FIRST, _JOIN_S = 0, 2.0


def wheel_calibration(config: T265Config) -> str:
    """The calibration JSON of one velocity sensor at the body's origin, in the body's axes."""
    from scipy.spatial.transform import Rotation

    body_from_camera = np.array([quat_rotate(config.mount_rotation_wxyz, axis) for axis in np.eye(3)]).T
    rotation = _CAMERA_FROM_ROBOT @ body_from_camera.T
    sigma_m_s = _SIGMA_M_S if config.wheel_sigma_m_s is None else config.wheel_sigma_m_s
    sensor = {
        "scale_and_alignment": np.eye(3).ravel().tolist(),
        "noise_variance": sigma_m_s**2,
        "extrinsics": {
            "T": (-rotation @ np.array(config.mount_position_m)).tolist(),
            "W": Rotation.from_matrix(rotation).as_rotvec().tolist(),
            **_UNUSED_VARIANCE,
        },
    }
    return json.dumps({"velocimeters": [sensor]})


def apply_settings(
    device: Any, library: Any, config: T265Config, name: str, *, beside: bool
) -> WheelVelocities | None:
    """Set the map options of the camera and, if configured, its wheel odometry.

    Args:
        device: device of the resolved profile; nothing streams yet.
        library: the module with the names of the options.
        config: the wanted options.
        name: name of the device in errors.
        beside: True if a thread sends velocities, so that the loop does not wait for USB.

    Returns:
        The sender of wheel velocities; None without wheel odometry.

    Raises:
        DeviceError: the camera does not know an option, or refuses the wheels.
    """
    known = getattr(library.option, OPTIONS["pose_jumping"])
    sensor = next((one for one in device.query_sensors() if one.supports(known)), None)
    if sensor is None:
        raise _other_firmware(name, "the camera has no settings for its map")
    for key, option in OPTIONS.items():
        value = float(getattr(config, key))
        sensor.set_option(getattr(library.option, option), value)
        if sensor.get_option(getattr(library.option, option)) != value:
            raise _other_firmware(name, f"the camera does not take {option} = {value:g}")
    if not config.wheel_odometry:
        return None
    try:
        wheels = sensor.as_wheel_odometer()
        taken = bool(wheels) and wheels.load_wheel_odometery_config(list(wheel_calibration(config).encode()))
    except VENDOR_ERRORS:
        taken = False
    if not taken:
        raise _other_firmware(name, "the camera takes no wheel odometry")
    return WheelVelocities(wheels, library, beside=beside)


def _other_firmware(name: str, what: str) -> DeviceError:
    return DeviceError(
        name,
        what,
        expected=f"firmware {LAST_FIRMWARE}, which pyrealsense2 {LAST_VERSION} loads",
        remedy="install that version and plug the camera in anew; or set tracker.wheel_odometry = false",
    )


class WheelVelocities:
    """Sends wheel velocities to the camera; only the newest where the camera is slow.

    Args:
        sensor: the camera's wheel odometer.
        library: the module with the type of its vectors.
        beside: True if a thread sends them.

    Attributes:
        refused: velocities that the camera did not take.
    """

    def __init__(self, sensor: Any, library: Any, *, beside: bool) -> None:
        self._sensor, self._library = sensor, library
        self._number = self.refused = 0
        self._queue: queue.Queue[tuple[float, float] | None] = queue.Queue(maxsize=1)
        self._thread: threading.Thread | None = None
        if beside:
            self._thread = threading.Thread(target=self._work, name="tracker-wheels", daemon=True)
            self._thread.start()

    def take(self, v_x_m_s: float, v_y_m_s: float) -> None:
        """Velocity of the body's origin in the body's axes; never waits, never raises."""
        if self._thread is None:
            self._send(v_x_m_s, v_y_m_s)
        else:
            self._put((v_x_m_s, v_y_m_s))

    def close(self) -> None:
        """End the thread. Idempotent."""
        thread, self._thread = self._thread, None
        if thread is not None:
            self._put(None)
            thread.join(_JOIN_S)

    def _put(self, item: tuple[float, float] | None) -> None:
        while True:
            try:
                return self._queue.put_nowait(item)
            except queue.Full:
                try:
                    self._queue.get_nowait()
                except queue.Empty:
                    continue

    def _work(self) -> None:
        while (velocity := self._queue.get()) is not None:
            self._send(*velocity)

    def _send(self, v_x_m_s: float, v_y_m_s: float) -> None:
        vector = self._library.vector()
        vector.x, vector.y, vector.z = v_x_m_s, v_y_m_s, 0.0
        self._number += 1
        try:
            taken = self._sensor.send_wheel_odometry(_FIRST, self._number, vector)
        except VENDOR_ERRORS:
            taken = False
        self.refused += not taken
