"""Meaning of MAVLink `ODOMETRY` (331): frames, quality, covariance; and the parser of its packets.

Pose: `frame_id` names the frame, `q` turns the axes of the camera's body into it. Twist: given in
`child_frame_id`, both velocity and rates. Covariances: upper triangles by rows, of (x, y, z, roll, pitch,
yaw) in the same two frames; a NaN in the first place means unknown. (MAVLink common.xml, message 331 and
enum MAV_FRAME.) Where a frame's z points down, a half turn about x makes it the z-up frame of the robot's
axes: x forward, y left, z up.
"""

import importlib
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hil.core.errors import ConfigError
from hil.core.geometry import Array, Three, rotated
from hil.support.extras import how_to_install

DIALECT = "pymavlink.dialects.v20.common"
FRAMES = {
    "LOCAL_NED": 1,
    "LOCAL_ENU": 4,
    "BODY_NED": 8,
    "BODY_FRD": 12,
    "BODY_FLU": 13,
    "LOCAL_FRD": 20,
    "LOCAL_FLU": 21,
}
"""Numbers of MAV_FRAME by name; BODY_NED is the older name of BODY_FRD, BODY_FLU is no longer in use."""
UPWARD = ("LOCAL_ENU", "LOCAL_FLU", "BODY_FLU")
"""Frames whose z points up, and y to the left of x."""
POSES = ("ODOMETRY", "VISION_POSITION_ESTIMATE")
"""Messages that carry a pose."""
FAILED, UNKNOWN_QUALITY = -1, 0
UNKNOWN = math.nan

_NAMES = {number: name for name, number in FRAMES.items()}
_ROWS, _COLUMNS = np.triu_indices(6)


def dialect() -> Any:
    """Pymavlink's generated messages; raises `ConfigError` with what to do when they cannot be imported."""
    try:
        return importlib.import_module(DIALECT)
    except ImportError as error:
        raise ConfigError(
            f'tracker.model = "mavlink" needs pymavlink, which cannot be imported ({error})',
            expected="the extra mavlink",
            remedy=how_to_install("mavlink"),
        ) from None


def frame_name(number: int) -> str:
    """Name of a MAV_FRAME without its prefix."""
    return _NAMES.get(number, f"MAV_FRAME {number}")


class Axes(NamedTuple):
    """Conversion of the numbers of an odometry message to robot axes.

    Attributes:
        turn_world: True if the pose's frame has z down and is turned about its x.
        turn_body: True if the quaternion turns a body with z down.
        turn_twist: True if the twist's frame has z down.
        twist_in_body: True if that frame moves with the body.
    """

    turn_world: bool
    turn_body: bool
    turn_twist: bool
    twist_in_body: bool


def axes_of(frame_id: int, child_frame_id: int, body_axes: str | None = None) -> Axes | None:
    """What the two frames of a message mean; None for frames that cannot be used together.

    Args:
        frame_id: number of the pose's frame, as sent.
        child_frame_id: number of the twist's frame, as sent.
        body_axes: `FRD` or `FLU` where the bench file says what the quaternion turns.
    """
    frame, child = _NAMES.get(frame_id, ""), _NAMES.get(child_frame_id, "")
    in_body = child.startswith("BODY")
    if not frame.startswith("LOCAL") or not (in_body or child == frame):
        return None
    turn_twist = child not in UPWARD
    turn_body = turn_twist if body_axes is None else body_axes == "FRD"
    return Axes(frame not in UPWARD, turn_body, turn_twist, in_body)


def pose_of(message: Any, axes: Axes) -> tuple[float, ...]:
    """Position (m) and quaternion (w first) of the camera in robot axes, in the z-up start frame."""
    x, y, z = message.x, message.y, message.z
    qw, qx, qy, qz = message.q
    if axes.turn_world:
        y, z = -y, -z
        qw, qx, qy, qz = -qx, qw, -qz, qy
    if axes.turn_body:
        qw, qx, qy, qz = qx, -qw, -qz, qy
    return x, y, z, qw, qx, qy, qz


def odometry_of(estimate: Any, common: Any) -> Any:
    """Convert a `VISION_POSITION_ESTIMATE` (102) to `ODOMETRY`.

    Its pose is in LOCAL_NED and its angles turn BODY_FRD, roll last (MAVLink common.xml). Twist and quality
    are unknown. A covariance of zeros has been left out by the sender, and is unknown too.
    """
    (sr, cr), (sp, cp), (sy, cy) = (
        (math.sin(0.5 * angle), math.cos(0.5 * angle))
        for angle in (estimate.roll, estimate.pitch, estimate.yaw)
    )
    turned = (
        cy * cp * cr + sy * sp * sr,
        cy * cp * sr - sy * sp * cr,
        cy * sp * cr + sy * cp * sr,
        sy * cp * cr - cy * sp * sr,
    )
    unknown = [UNKNOWN] * 21
    covariance = list(estimate.covariance) if any(estimate.covariance) else unknown
    return common.MAVLink_odometry_message(
        estimate.usec,
        FRAMES["LOCAL_NED"],
        FRAMES["BODY_FRD"],
        estimate.x,
        estimate.y,
        estimate.z,
        turned,
        *[UNKNOWN] * 6,
        covariance,
        unknown,
        estimate.reset_counter,
        0,
        UNKNOWN_QUALITY,
    )


def twist_of(message: Any, axes: Axes, quaternion_wxyz: Sequence[float]) -> tuple[float, ...]:
    """Velocity (m/s) and rates (rad/s) in the axes of the start frame; all NaN where one of them is."""
    linear = message.vx, message.vy, message.vz
    angular = message.rollspeed, message.pitchspeed, message.yawspeed
    if not all(map(math.isfinite, (*linear, *angular))):
        return (UNKNOWN,) * 6
    return (*_to_start(linear, axes, quaternion_wxyz), *_to_start(angular, axes, quaternion_wxyz))


def pose_covariance(message: Any, axes: Axes) -> Array | None:
    """(6, 6) of position (m) and small rotation (rad), in the axes of the start frame; None if unknown."""
    down = -1.0 if axes.turn_world else 1.0
    return _turned(message.pose_covariance, np.diag([1.0, down, down]))


def _to_start(vector: Sequence[float], axes: Axes, quaternion_wxyz: Sequence[float]) -> Three:
    """A vector of the twist in the axes of the start frame."""
    x, y, z = vector
    if axes.turn_twist:
        y, z = -y, -z
    return rotated(quaternion_wxyz, (x, y, z)) if axes.twist_in_body else (x, y, z)


def _turned(upper: Sequence[float], turn: Array) -> Array | None:
    """The symmetric matrix of an upper triangle, each 3-vector turned; None unless it is a covariance."""
    values = np.asarray(upper, dtype=np.float64)
    if not np.all(np.isfinite(values)):
        return None
    full = np.zeros((6, 6))
    full[_ROWS, _COLUMNS] = full[_COLUMNS, _ROWS] = values
    if np.any(np.diag(full) < 0.0):
        return None
    both = np.kron(np.eye(2), turn)
    turned: Array = both @ full @ both.T
    return turned


class Parser:
    """Splits bytes into MAVLink messages; other bytes become messages of type `BAD_DATA`.

    Args:
        common: the dialect.
        datagrams: True if each call gets whole packets: the rest of a damaged one is not joined to the next.
    """

    def __init__(self, common: Any, *, datagrams: bool) -> None:
        self._common, self._datagrams = common, datagrams
        self._stream = self._new()

    def feed(self, data: bytes) -> list[Any]:
        """Messages that are complete with these bytes."""
        if self._datagrams:
            self._stream = self._new()
        found: list[Any] = self._stream.parse_buffer(data) or []
        return found

    def _new(self) -> Any:
        stream = self._common.MAVLink(None)
        stream.robust_parsing = True
        return stream
