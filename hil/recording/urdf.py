"""The robot as a URDF, from the header of a recording: its joints take the servos' own angles.

`body` is the root. On it hangs a `fork` for each wheel, turned by the joint `steer_*`, and on that a `tyre`,
turned by `drive_*`. Joint names and angles are those of `/joint_states`, so signs and zeros of the bench are
in the joints' axes and origins. Sensors hang on fixed joints. Shapes are simple, and there are no inertias:
the URDF is for display only.
"""

import math
import re
from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np

from hil.config.robot import RobotConfig
from hil.core.geometry import rotated
from hil.core.signals import WHEELS
from hil.recording.transform_tree import BODY, fixed_frames

_TYRE_WIDTH_M, _PLATE_M, _CLEARANCE_M, _SENSOR_M = 0.022, 0.008, 0.012, 0.02
_PLATE_SHARE = 0.6
_PAINT = {"plate": "0.7 0.73 0.78 1", "nose": "0 0.43 0.9 1", "rubber": "0.16 0.16 0.17 1"}


def urdf(header: Mapping[str, Any]) -> str:
    """URDF of the robot that a header describes: calibrated wheels, alignment, mounts.

    Args:
        header: header of a recording, or of a bench, with its `geometry`.
    """
    config = header.get("config", {})
    robot = RobotConfig.model_validate(config.get("robot", {}))
    x_m, y_m, radius_m, zero_rad = np.array(header["geometry"], dtype=np.float64).reshape(4, 4)
    top_m = 2.0 * float(np.max(radius_m)) + _CLEARANCE_M
    root = Xml.Element("robot", name=_identifier(robot.name or str(config.get("name", "robot"))))
    for name, rgba in _PAINT.items():
        Xml.SubElement(Xml.SubElement(root, "material", name=name), "color", rgba=rgba)
    _body(root, robot, top_m)
    alignment = config.get("alignment", {})
    drive_sign = alignment.get("drive_sign", (1, 1, 1, 1))
    steer_sign = alignment.get("steer_sign", (1, 1, 1, 1))
    servo_zero_rad = alignment.get("steer_zero_rad", (0.0,) * 4)
    for i, wheel in enumerate(WHEELS):
        place = (float(x_m[i]), float(y_m[i]), float(radius_m[i]))
        turned_rad = -steer_sign[i] * servo_zero_rad[i] - float(zero_rad[i])
        Xml.SubElement(root, "link", name=f"fork_{wheel}")
        _joint(
            root, f"steer_{wheel}", BODY, f"fork_{wheel}", place, (0, 0, turned_rad), (0, 0, steer_sign[i])
        )
        _tyre(root, wheel, float(radius_m[i]))
        _joint(root, f"drive_{wheel}", f"fork_{wheel}", f"tyre_{wheel}", axis=(0, drive_sign[i], 0))
    for frame in fixed_frames(header):
        if frame.parent == BODY and not frame.child.startswith("wheel_"):
            _box(Xml.SubElement(root, "link", name=frame.child), (_SENSOR_M,) * 3, (0, 0, 0), "nose")
            turn = _roll_pitch_yaw(frame.quaternion_wxyz)
            _joint(root, f"{frame.child}_mount", BODY, frame.child, frame.position_m, turn)
    Xml.indent(root)
    return Xml.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _identifier(name: str) -> str:
    return re.sub(r"\W", "_", name, flags=re.ASCII) or "robot"


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value + 0.0:.9g}" for value in values)


def _body(root: Xml.Element, robot: RobotConfig, top_m: float) -> None:
    """A plate above the wheels, with a nose in front."""
    length_m, width_m = (_PLATE_SHARE * size for size in robot.outline_m)
    link = Xml.SubElement(root, "link", name=BODY)
    _box(link, (length_m, width_m, _PLATE_M), (0, 0, top_m), "plate")
    _box(link, (0.2 * length_m, 0.1 * width_m, _PLATE_M), (0.6 * length_m, 0, top_m), "nose")


def _box(link: Xml.Element, size: tuple[float, ...], place: tuple[float, ...], paint: str) -> None:
    visual = Xml.SubElement(link, "visual")
    Xml.SubElement(visual, "origin", xyz=_numbers(place), rpy="0 0 0")
    Xml.SubElement(Xml.SubElement(visual, "geometry"), "box", size=_numbers(size))
    Xml.SubElement(visual, "material", name=paint)


def _tyre(root: Xml.Element, wheel: str, radius_m: float) -> None:
    """A cylinder about the axle, with a bar across it so that one sees it turn."""
    link = Xml.SubElement(root, "link", name=f"tyre_{wheel}")
    visual = Xml.SubElement(link, "visual")
    Xml.SubElement(visual, "origin", xyz="0 0 0", rpy=_numbers((math.pi / 2.0, 0, 0)))
    shape = Xml.SubElement(visual, "geometry")
    Xml.SubElement(shape, "cylinder", radius=_numbers((radius_m,)), length=_numbers((_TYRE_WIDTH_M,)))
    Xml.SubElement(visual, "material", name="rubber")
    _box(link, (1.8 * radius_m, 1.1 * _TYRE_WIDTH_M, 0.2 * radius_m), (0, 0, 0), "plate")


def _joint(
    root: Xml.Element,
    name: str,
    parent: str,
    child: str,
    place: tuple[float, ...] = (0, 0, 0),
    turn: tuple[float, ...] = (0, 0, 0),
    axis: tuple[float, ...] | None = None,
) -> None:
    joint = Xml.SubElement(root, "joint", name=name, type="fixed" if axis is None else "continuous")
    Xml.SubElement(joint, "parent", link=parent)
    Xml.SubElement(joint, "child", link=child)
    Xml.SubElement(joint, "origin", xyz=_numbers(place), rpy=_numbers(turn))
    if axis is not None:
        Xml.SubElement(joint, "axis", xyz=_numbers(axis))


def _roll_pitch_yaw(quaternion_wxyz: tuple[float, ...]) -> tuple[float, float, float]:
    """Fixed-axis angles of URDF: about x, then y, then z of the parent."""
    x, y, z = (rotated(quaternion_wxyz, axis) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1)))
    pitch_rad = math.atan2(-x[2], math.hypot(y[2], z[2]))
    if math.hypot(y[2], z[2]) < 1e-9:
        return 0.0, pitch_rad, math.atan2(-y[0], y[1])
    return math.atan2(y[2], z[2]), pitch_rad, math.atan2(x[1], x[0])
