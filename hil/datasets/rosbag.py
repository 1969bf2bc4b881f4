"""Reads rosbag2 recordings (MCAP or SQLite) of a real robot through a topic mapping in TOML.

See `hil.datasets.topic_map` for the mapping. Stamps are those of the message headers; if they are all 0 in a
topic, the log times are used instead.
"""

import hashlib
import logging
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hil.core.clock import NS_PER_S
from hil.core.errors import DataError
from hil.core.geometry import Array
from hil.datasets.bag_check import CONVERT
from hil.datasets.bag_messages import CDR, STORAGES, opened_bag, storage_files, storage_suffix
from hil.datasets.bag_rows import JointRows, TruthPoses
from hil.datasets.bag_sensors import ImuRows, TrackerRows, check_sensor_times, sensor_log, shifted
from hil.datasets.cleaning import Log
from hil.datasets.frame_tree import broken_frames
from hil.datasets.nominal_robot import Nominal
from hil.datasets.recording_names import motion_of
from hil.datasets.sensor_times import lateness_s
from hil.datasets.topic_map import TopicMap, WheelTopic
from hil.datasets.twist_rows import TwistRows
from hil.datasets.unpacking import unpacked
from hil.datasets.wheel_log import Recording, build_recording
from hil.recording.mcap_scan import BagTopic

LOG = logging.getLogger(__name__)
_POSES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "nav_msgs/msg/Odometry",
)
TYPES = {
    "wheels": ("sensor_msgs/msg/JointState",),
    "odometry": (
        "nav_msgs/msg/Odometry",
        "geometry_msgs/msg/TwistWithCovarianceStamped",
        "geometry_msgs/msg/TwistStamped",
    ),
    "truth": _POSES,
    "imu": ("sensor_msgs/msg/Imu",),
    "tracker": _POSES,
}
"""Types of messages of each table of the mapping."""
_DAY_NS = 86_400 * NS_PER_S
_BLOCK_BYTES = 1 << 20


@dataclass(frozen=True)
class _Stamp:
    """Position of a message: `number` in the bag, header stamp and log time, ns."""

    number: int
    header_ns: int
    log_ns: int


def is_bag(path: Path) -> bool:
    """Whether a path looks like a rosbag2 recording: a folder with its metadata, or a storage file."""
    return (path / "metadata.yaml").exists() if path.is_dir() else storage_suffix(path) in STORAGES


def bags_in(folder: Path) -> list[Path]:
    """Bags of a folder, by name: the folder itself if it is one, else the bags in it."""
    return [folder] if is_bag(folder) else sorted(p for p in folder.iterdir() if is_bag(p))


def read_bag(path: str | Path, topics: TopicMap, nominal: Nominal | None = None) -> Recording:
    """Read wheels and ground truth of a bag: a rosbag2 folder, or one of its `.mcap` or `.db3` files.

    Raises:
        DataError: the bag is unreadable, a topic or joint is missing, or the data cannot be used.
    """
    file = Path(path)
    if file.is_dir() and not is_bag(file):
        _refuse_folder(file)
    with unpacked(file) as plain:
        try:
            found = _read(plain, topics, nominal)
        except DataError as error:
            if plain == file:
                raise
            raise DataError(
                str(file),
                error.message.removeprefix(f"{plain}: "),
                expected=error.expected,
                remedy=error.remedy,
            ) from None
        digests = tuple(_digest(storage) for storage in storage_files(plain))
    parts = [replace(part, sources=(str(file),), sha256=digests) for part in (found, *found.later)]
    return replace(parts[0], later=tuple(parts[1:]))


def _digest(file: Path) -> str:
    """SHA-256 of a file, read in blocks."""
    digest = hashlib.sha256()
    with file.open("rb") as stream:
        while block := stream.read(_BLOCK_BYTES):
            digest.update(block)
    return digest.hexdigest()


def _read(file: Path, topics: TopicMap, nominal: Nominal | None) -> Recording:
    names, robot = topics.topics, nominal if nominal is not None else Nominal()
    tracker = TrackerRows()
    imu = ImuRows(removed=topics.imu is not None and topics.imu.gravity == "removed")
    rows_of: dict[str, Any] = {"odometry": TwistRows(), "imu": imu, "tracker": tracker}
    if topics.wheels is not None:
        rows_of["wheels"] = JointRows(file, topics.wheels.topic, topics.wheels.joints)
    if topics.truth is not None:
        rows_of["truth"] = TruthPoses(file, topics.truth)
    collectors = {topic: rows_of[table] for table, topic in names.items()}
    stamps: dict[str, list[_Stamp]] = {topic: [] for topic in collectors}
    for topic, stamp, message in _messages(file, {topic: TYPES[table] for table, topic in names.items()}):
        stamps[topic].append(stamp)
        collectors[topic].add(message)
    if empty := [topic for topic, found in stamps.items() if not found]:
        raise DataError(
            str(file),
            f"{' and '.join(empty)} {'hold' if len(empty) > 1 else 'holds'} no message",
            expected="messages on each topic of the mapping",
            remedy="name topics with messages in the mapping (`ros2 bag info` counts them), or leave it out",
        )
    times = _times(file, stamps)
    if topics.wheels is not None:
        wheel_s, rows = rows_of["wheels"].rows(times[topics.wheels.topic])
        rows = _signed(topics.wheels, rows)
    else:
        twist_s = times[names["odometry"]]
        wheel_s, rows = rows_of["odometry"].rows(file, names["odometry"], twist_s, robot.geometry)
    truth, repairs = None, dict[str, int]()
    if topics.truth is not None:
        known, planar, repairs = rows_of["truth"].rows()
        truth = Log(times[topics.truth.topic][known], planar)
    for problem in broken_frames(file):
        LOG.warning("%s: %s", file, problem)
    found = build_recording(
        file.stem,
        Log(wheel_s, rows),
        truth,
        motion=motion_of(file.stem),
        sources=(str(file),),
        nominal=robot,
        repairs=repairs,
        of_twist=topics.wheels is None,
        with_sensors=topics.imu is not None or topics.tracker is not None,
    )
    found = replace(found, unused=unused_topics(file, set(names.values())))
    sensors = {names[table]: rows_of[table] for table in ("imu", "tracker") if table in names}
    if not sensors:
        return found
    check_sensor_times(file, found, {topic: times[topic] for topic in sensors})
    log = sensor_log(
        file,
        topics,
        imu.samples(times[names["imu"]]) if "imu" in names else (),
        tracker.samples(times[names["tracker"]]) if "tracker" in names else (),
    )
    return _with_fitted(file, topics, replace(found, sensors=log), robot)


def _with_fitted(file: Path, topics: TopicMap, found: Recording, robot: Nominal) -> Recording:
    """The recording with stamps shifted where a table says `latency_s = "fit"`; each shift is a repair."""
    tables = (("imu", topics.imu), ("tracker", topics.tracker))
    asked = [name for name, table in tables if table is not None and table.latency_s == "fit"]
    if not asked:
        return found
    late = lateness_s(found, robot.geometry)
    if unknown := [f"[{name}]" for name in asked if name not in late]:
        raise DataError(
            str(file),
            f"its motion does not determine the lateness of {' and '.join(unknown)}",
            expected="a drive that changes its speed and direction",
            remedy="give latency_s in numbers",
        )
    by_s = [late[name] if name in asked else 0.0 for name, _ in tables]
    shifts = {f"shift of the stamps of [{name}] by {late[name]:.3f} s, fitted": 1 for name in asked}
    repairs = {**found.repairs, **shifts}
    return replace(found, sensors=shifted(found.sensors, *by_s), repairs=repairs)


def unused_topics(file: Path, used: Collection[str]) -> tuple[str, ...]:
    """Topics of a bag that a table of the mapping could name and none does, each with its type."""
    kinds = {kind for group in TYPES.values() for kind in group}
    with opened_bag(file) as bag:
        there = {topic.name: topic.kind for topics in bag.topics for topic in topics}
    left = (name for name, kind in sorted(there.items()) if kind in kinds and name not in used)
    return tuple(f"{name} ({there[name]})" for name in left)


def _refuse_folder(folder: Path) -> None:
    """Raise `DataError` for a folder that is no bag, and name the bags in it."""
    names = [p.name for p in bags_in(folder)]
    if names:
        raise DataError(
            str(folder), f"is a folder of {len(names)} recordings ({', '.join(names)})", remedy="name one"
        )
    raise DataError(
        str(folder),
        "is a folder without a rosbag2 recording",
        expected="metadata.yaml with its files, or a .mcap or .db3 file",
    )


def _times(path: Path, stamps: Mapping[str, Sequence[_Stamp]]) -> dict[str, Array]:
    """Times (n,) of the messages of each topic, s since the first message in the bag."""
    taken_ns = {}
    for topic, found in stamps.items():
        stamped = any(one.header_ns for one in found)
        if stamped:
            _check_stamps(path, topic, found)
        taken_ns[topic] = [one.header_ns if stamped else one.log_ns for one in found]
    firsts = [(found[0].number, taken_ns[topic][0]) for topic, found in stamps.items() if found]
    origin_ns = min(firsts)[1] if firsts else 0
    return {
        topic: np.array([(t_ns - origin_ns) / NS_PER_S for t_ns in all_ns], dtype=np.float64)
        for topic, all_ns in taken_ns.items()
    }


def _check_stamps(path: Path, topic: str, stamps: Sequence[_Stamp]) -> None:
    """Raise `DataError` if a stamp's offset from the log time is a day or more off the typical offset."""
    behind_ns = [one.log_ns - one.header_ns for one in stamps]
    usual_ns = sorted(behind_ns)[len(behind_ns) // 2]
    off = [k for k, behind in enumerate(behind_ns) if abs(behind - usual_ns) > _DAY_NS]
    if not off:
        return
    k = off[0]
    at_s = (stamps[k].log_ns - stamps[0].log_ns) / NS_PER_S
    others = f"; {len(off) - 1} more are" if len(off) > 1 else ""
    raise DataError(
        str(path),
        f"{topic}: message {k + 1} of {len(stamps)}, recorded {at_s:.2f} s after the first, is stamped "
        f"{stamps[k].header_ns / NS_PER_S:.3f} s, {(usual_ns - behind_ns[k]) / NS_PER_S:.3g} s from where it "
        f"belongs{others}",
        expected="header.stamp of one clock in all messages of a topic",
        remedy="take it out, or cut the bag before or behind it (`mcap filter`, `ros2 bag convert`)",
    )


def _messages(path: Path, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, _Stamp, Any]]:
    """Iterate over topic, stamp and message of the wanted topics, each with its possible types."""
    with opened_bag(path) as bag:
        there = {topic.name: topic for topics in bag.topics for topic in topics}
        if missing := [name for name in wanted if name not in there]:
            raise DataError(
                str(path),
                f"has no topic {', '.join(missing)}",
                expected=f"one of {', '.join(sorted(there))}" if there else "topics with messages",
            )
        for topic in (topic for topics in bag.topics for topic in topics if topic.name in wanted):
            _check_encoding(path, topic)
            _check_type(path, topic.name, topic.kind, wanted[topic.name])
        for number, (topic, log_ns, message) in enumerate(bag.messages(wanted)):
            at = message.header.stamp
            yield topic.name, _Stamp(number, at.sec * NS_PER_S + at.nanosec, log_ns), message


def _check_encoding(path: Path, topic: BagTopic) -> None:
    """Raise `DataError` for messages that are not encoded as CDR."""
    if topic.encoding != CDR:
        raise DataError(
            str(path), f"{topic.name} is encoded as {topic.encoding!r}", expected=CDR, remedy=CONVERT
        )


def _check_type(path: Path, topic: str, kind: str, expected: Sequence[str]) -> None:
    """Raise `DataError` for a topic whose type is wrong for its table."""
    if kind not in expected:
        raise DataError(str(path), f"{topic} is of another type ({kind})", expected=" or ".join(expected))


def _signed(wheels: WheelTopic, rows: Array) -> Array:
    """Rows (n, 12) with the signs and steering zeros of the mapping applied."""
    drive_sign = np.array(wheels.drive_sign)
    steering = np.array(wheels.steer_sign) * (rows[:, 4:8] - np.array(wheels.steer_zero_rad))
    return np.column_stack([drive_sign * rows[:, :4], steering, drive_sign * rows[:, 8:]])
