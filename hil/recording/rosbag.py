"""Reads rosbag2 recordings (MCAP or SQLite) of a real robot through a topic mapping in TOML.

The mapping says which joints are which wheel and where ground truth comes from::

    schema = 1
    [wheels]
    topic = "/joint_states"                    # sensor_msgs/JointState, rad
    drive = ["fl_drive", "bl_drive", "br_drive", "fr_drive"]
    steer = ["fl_steer", "bl_steer", "br_steer", "fr_steer"]
    drive_sign = [1, 1, 1, 1]                  # optional, as are the next two
    steer_sign = [1, 1, 1, 1]
    steer_zero_rad = [0.0, 0.0, 0.0, 0.0]
    [truth]
    topic = "/mocap/pose"                      # PoseStamped, PoseWithCovarianceStamped or Odometry

Stamps are those of the message headers; a header without a stamp falls back to the log time.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from hil.calibration.datasets import Log, Recording, build_recording
from hil.calibration.nominal import Nominal
from hil.recording.bag_check import check_bag
from hil.recording.frame_check import broken_frames
from hil.vocabulary.clock import NS_PER_S
from hil.vocabulary.errors import ConfigError, DataError, HilError
from hil.vocabulary.geometry import yaw_of_quat
from hil.vocabulary.reading import read_toml

LOG = logging.getLogger(__name__)

_JOINTS = "sensor_msgs/msg/JointState"
_POSES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "nav_msgs/msg/Odometry",
)
_STORAGES = (".mcap", ".db3")
_REPAIR = {".mcap": "repair it with `mcap recover`", ".db3": "repair it with `sqlite3 FILE .recover`"}
_REINDEX = "write its metadata.yaml afresh with `ros2 bag reindex`"
_Names = tuple[str, str, str, str]
_Signs = tuple[Literal[1, -1], Literal[1, -1], Literal[1, -1], Literal[1, -1]]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class WheelTopic(_Strict):
    """Joints of the wheels, order FL, BL, BR, FR."""

    topic: str
    drive: _Names
    steer: _Names
    drive_sign: _Signs = (1, 1, 1, 1)
    steer_sign: _Signs = (1, 1, 1, 1)
    steer_zero_rad: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


class TruthTopic(_Strict):
    """Planar ground truth: x, y and the rotation about z of the pose."""

    topic: str


class TopicMap(_Strict):
    """Which topic of a bag is what."""

    schema_version: Literal[1] = Field(alias="schema")
    wheels: WheelTopic
    truth: TruthTopic


def read_topic_map(path: str | Path) -> TopicMap:
    """Topic mapping of a TOML file.

    Raises:
        ConfigError: unreadable or wrong, with every problem.
    """
    try:
        return TopicMap.model_validate(read_toml(Path(path)))
    except ValidationError as error:
        problems = tuple(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors())
        raise ConfigError(f"{path}: {len(problems)} problem(s)", problems=problems) from None


def is_bag(path: Path) -> bool:
    """Whether a path looks like a rosbag2 recording: a folder with its metadata, or a storage file."""
    return (path / "metadata.yaml").exists() if path.is_dir() else path.suffix in _STORAGES


def bags_in(folder: Path) -> list[Path]:
    """Bags of a folder, by name: itself if it is one, else those that lie in it."""
    return [folder] if is_bag(folder) else sorted(p for p in folder.iterdir() if is_bag(p))


def read_bag(path: str | Path, topics: TopicMap, nominal: Nominal | None = None) -> Recording:
    """Wheels and ground truth of a bag: a rosbag2 folder, or a `.mcap` or `.db3` file of one.

    Raises:
        DataError: unreadable, a topic or joint is missing, or the data cannot be used.
    """
    file = Path(path)
    if file.is_dir() and not is_bag(file):
        _refuse_folder(file)
    wheel_rows: list[tuple[float, list[float]]] = []
    truth_rows: list[tuple[float, list[float]]] = []
    for topic, t_s, message in _messages(file, (topics.wheels.topic, topics.truth.topic)):
        if topic == topics.truth.topic:
            truth_rows.append((t_s, _planar(message)))
        else:
            index = _joints(file, topics.wheels, message)
            wheel_rows.append((t_s, _wheel_row(file, topics.wheels, index, message)))
    for problem in broken_frames(file):
        LOG.warning("%s: %s", file, problem)
    return build_recording(
        file.stem,
        _log(wheel_rows, 12),
        _log(truth_rows, 3),
        motion=file.stem.rpartition("_")[0] or file.stem,
        sources=(str(file),),
        sha256=(hashlib.sha256(file.read_bytes()).hexdigest(),) if file.is_file() else (),
        nominal=nominal,
    )


def _refuse_folder(folder: Path) -> None:
    """Raises `DataError` for a folder that is no bag, with the bags that lie in it."""
    names = [p.name for p in bags_in(folder)]
    if names:
        raise DataError(
            str(folder), f"is a folder of {len(names)} recordings ({', '.join(names)})", remedy="name one"
        )
    raise DataError(
        str(folder), "is a folder without a rosbag2 recording",
        expected="metadata.yaml with its files, or a .mcap or .db3 file",
    )  # fmt: skip


def _log(rows: list[tuple[float, list[float]]], width: int) -> Log:
    return Log(
        np.array([t for t, _ in rows]), np.array([v for _, v in rows], dtype=np.float64).reshape(-1, width)
    )


def _messages(path: Path, wanted: tuple[str, ...]) -> Iterator[tuple[str, float, Any]]:
    """Topic, time since the first message (s) and message, of the wanted topics."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    origin_ns: int | None = None
    check_bag(path)
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
            if any(getattr(reader, "compression_mode", None) == "message" for reader in bag.readers):
                raise DataError(
                    str(path),
                    "is packed message by message, which cannot be unpacked within bounds",
                    remedy="convert it with `ros2 bag convert`, to MCAP with compressed chunks",
                )
            there = {c.topic for c in bag.connections}
            missing = [t for t in wanted if t not in there]
            if missing:
                raise DataError(
                    str(path),
                    f"has no topic {', '.join(missing)}",
                    expected=f"one of {', '.join(sorted(there))}",
                )
            chosen = [c for c in bag.connections if c.topic in wanted]
            for connection in chosen:
                _check_type(path, connection.topic, connection.msgtype, joints=connection.topic == wanted[0])
            for connection, log_ns, raw in bag.messages(connections=chosen):
                message: Any = bag.deserialize(raw, connection.msgtype)
                stamp = message.header.stamp
                t_ns = stamp.sec * NS_PER_S + stamp.nanosec or log_ns
                origin_ns = t_ns if origin_ns is None else origin_ns
                yield connection.topic, (t_ns - origin_ns) / NS_PER_S, message
    except HilError:
        raise
    except Exception as error:  # a library that reads foreign files may raise anything
        raise DataError(
            str(path),
            f"is not a readable rosbag2 recording ({str(error) or type(error).__name__})",
            remedy=_REPAIR.get(path.suffix, _REINDEX),
        ) from None


def _check_type(path: Path, topic: str, kind: str, *, joints: bool) -> None:
    """Raises `DataError` for a topic of a type that cannot be wheels or ground truth."""
    expected = (_JOINTS,) if joints else _POSES
    if kind not in expected:
        raise DataError(str(path), f"{topic} is of another type ({kind})", expected=" or ".join(expected))


def _joints(path: Path, wheels: WheelTopic, message: Any) -> dict[str, int]:
    index = {name: i for i, name in enumerate(message.name)}
    missing = [name for name in (*wheels.drive, *wheels.steer) if name not in index]
    if missing:
        raise DataError(
            str(path),
            f"{wheels.topic} has no joint {', '.join(missing)}",
            expected=f"some of {', '.join(index)}",
        )
    return index


def _wheel_row(path: Path, wheels: WheelTopic, index: dict[str, int], message: Any) -> list[float]:
    names = (*wheels.drive, *wheels.steer)
    if len(message.position) < len(index):
        raise DataError(
            str(path), f"{wheels.topic} carries {len(message.position)} positions", expected="one per joint"
        )
    position = np.array([message.position[index[n]] for n in names])
    has_rates = len(message.velocity) == len(message.position)
    rate = np.array([message.velocity[index[n]] for n in wheels.drive]) if has_rates else np.full(4, np.nan)
    drive_sign = np.array(wheels.drive_sign)
    steering = np.array(wheels.steer_sign) * (position[4:] - np.array(wheels.steer_zero_rad))
    return [*(drive_sign * position[:4]), *steering, *(drive_sign * rate)]


def _planar(message: Any) -> list[float]:
    pose = getattr(message.pose, "pose", message.pose)
    q = pose.orientation
    return [pose.position.x, pose.position.y, yaw_of_quat([q.w, q.x, q.y, q.z])]
