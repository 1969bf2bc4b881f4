"""A robot whose wheels are those of the drawing and do not slip: what odometry must err by is known.

It curves with a steering that never rests, between two rests. Logs are made here, bags by `rosbags`; nothing
of the project's own simulation or writers takes part.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from hil.datasets.rosbag import read_bag
from hil.datasets.topic_map import read_topic_map

STORE = get_typestore(Stores.ROS2_HUMBLE)
JOINT, POSE = "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped"
DRIVE, STEER = [f"w{i}" for i in range(1, 5)], [f"s{i}" for i in range(1, 5)]
MAPPING = """
schema = 2
[wheels]
topic = "/wheels"
drive = ["w1", "w2", "w3", "w4"]
steer = ["s1", "s2", "s3", "s4"]
[truth]
topic = "/vicon"
"""
BEGIN_NS = 1_700_000_000_000_000_000
RADIUS_M, HALF_M = 0.0254, 0.1125
WHEELS_M = np.array([[HALF_M, HALF_M], [-HALF_M, HALF_M], [-HALF_M, -HALF_M], [HALF_M, -HALF_M]])
REST_S, DRIVE_S = 1.5, 17.0
COLUMNS = (
    "t",
    *(f"phi{i}" for i in range(1, 5)),
    *(f"delta{i}" for i in range(1, 5)),
    "x",
    "y",
    "theta",
    *(f"w{i}" for i in range(1, 5)),
)


@dataclass(frozen=True)
class Drive:
    """Wheel rows (n,) with angles, steering and rates (n, 4), and ground truth (m,) with poses (m, 3)."""

    t_s: np.ndarray
    phi: np.ndarray
    delta: np.ndarray
    rate: np.ndarray
    truth_s: np.ndarray
    pose: np.ndarray

    def wheels_where(self, keep):
        rows = {name: getattr(self, name)[keep] for name in ("t_s", "phi", "delta", "rate")}
        return replace(self, **rows)

    def truth_where(self, keep):
        return replace(self, truth_s=self.truth_s[keep], pose=self.pose[keep])


def drive(*, truth_hz=100.0, wheel_hz=62.5, noise=2e-4, seed=0, sense=1.0, radius_m=RADIUS_M, zero=0.0):
    """A drive between two rests.

    Args:
        truth_hz, wheel_hz: rates of the rows.
        noise: of the ground truth, m and rad.
        seed: of the noise.
        sense: 1 or -1, the way round of the curve.
        radius_m: of the true wheels.
        zero: of their steering, rad.
    """
    step = 1e-3
    at = np.arange(0.0, 2.0 * REST_S + DRIVE_S, step)
    since = np.clip(at - REST_S, 0.0, DRIVE_S)
    speed = 0.15 * np.minimum(1.0, np.minimum(since, DRIVE_S - since) / 0.8)
    bend = sense * (0.5 + 1.3 * np.sin(0.7 * since) ** 2) * np.minimum(1.0, since)
    twist = np.column_stack([speed, 0.3 * speed * np.sin(0.9 * since), speed * bend])
    shape = np.column_stack([np.ones_like(at), 0.3 * np.sin(0.9 * since), bend])
    ahead = shape[:, :1] - shape[:, 2:] * WHEELS_M[:, 1]
    left = shape[:, 1:2] + shape[:, 2:] * WHEELS_M[:, 0]
    rate = np.hypot(ahead, left) * speed[:, None] / radius_m
    phi = np.concatenate([np.zeros((1, 4)), np.cumsum(0.5 * (rate[1:] + rate[:-1]) * step, axis=0)])
    middle = 0.5 * (twist[1:] + twist[:-1]) * step
    theta = np.concatenate([[0.2], 0.2 + np.cumsum(middle[:, 2])])
    heading = theta[:-1] + 0.5 * middle[:, 2]
    c, s = np.cos(heading), np.sin(heading)
    way = np.column_stack([c * middle[:, 0] - s * middle[:, 1], s * middle[:, 0] + c * middle[:, 1]])
    place = np.array([1.0, 0.5]) + np.concatenate([np.zeros((1, 2)), np.cumsum(way, axis=0)])
    path = np.column_stack([place, theta])
    wheel_s, truth_s = np.arange(0.0, at[-1], 1.0 / wheel_hz), np.arange(0.004, at[-1], 1.0 / truth_hz)

    def at_rows(rows_s, values):
        return np.column_stack([np.interp(rows_s, at, column) for column in values.T])

    rng = np.random.default_rng(seed)
    seen = at_rows(truth_s, path) + rng.normal(0.0, noise, (len(truth_s), 3))
    delta = at_rows(wheel_s, np.arctan2(left, ahead)) + zero
    return Drive(wheel_s, at_rows(wheel_s, phi), delta, at_rows(wheel_s, rate), truth_s, seen)


def header(t_s):
    return header_at(BEGIN_NS + round(t_s * 1e9))


def header_at(t_ns):
    stamp = STORE.types["builtin_interfaces/msg/Time"](sec=t_ns // 10**9, nanosec=t_ns % 10**9)
    return STORE.types["std_msgs/msg/Header"](stamp=stamp, frame_id="")


def joints(t_s, phi, delta, rate):
    position, velocity = (np.array([*a, *b], dtype=np.float64) for a, b in ((phi, delta), (rate, [0.0] * 4)))
    return STORE.types[JOINT](header(t_s), [*DRIVE, *STEER], position, velocity, np.array([]))


def pose(t_s, place, quaternion=None):
    """A planar pose (3,), or one at `place` (3,) m with a quaternion wxyz."""
    kinds = STORE.types
    if quaternion is None:
        half = 0.5 * place[2]
        place, quaternion = (place[0], place[1], 0.0), (math.cos(half), 0, 0, math.sin(half))
    w, x, y, z = map(float, quaternion)
    return STORE.types[POSE](
        header(t_s),
        kinds["geometry_msgs/msg/Pose"](
            position=kinds["geometry_msgs/msg/Point"](*map(float, place)),
            orientation=kinds["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
        ),
    )


def messages(found, *, make_pose=pose):
    """Of a drive: topic, log time (s) and message, in order of the log."""
    rows = zip(found.t_s, found.phi, found.delta, found.rate, strict=True)
    wheels = (("/wheels", t, joints(t, *row)) for t, *row in rows)
    truth = (("/vicon", t, make_pose(t, row)) for t, row in zip(found.truth_s, found.pose, strict=True))
    return sorted([*wheels, *truth], key=lambda one: one[1])


def write_bag(folder, found, plugin=StoragePlugin.MCAP):
    """A rosbag2 recording of messages."""
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        lanes = {
            topic: (writer.add_connection(topic, kind, typestore=STORE), kind)
            for topic, kind in (("/wheels", JOINT), ("/vicon", POSE))
        }
        for topic, log_s, message in found:
            lane, kind = lanes[topic]
            writer.write(lane, BEGIN_NS + round(log_s * 1e9), STORE.serialize_cdr(message, kind))
    return folder


def bag_as_read(folder):
    """A rosbag2 recording of a drive, its mapping, and what is read of it."""
    (folder / "topics.toml").write_text(MAPPING)
    made = write_bag(folder / "curve_1", messages(drive()))
    mapping = read_topic_map(folder / "topics.toml")
    return made, mapping, read_bag(made, mapping)


def write_csv(path, found, *, order=None):
    """A plain table: a row for each of wheels and ground truth, in order of time, or as `order` (n,) says."""
    table = np.full((len(found.t_s) + len(found.truth_s), len(COLUMNS)), np.nan)
    wheels, truth = table[: len(found.t_s)], table[len(found.t_s) :]
    wheels[:, :9] = np.column_stack([found.t_s, found.phi, found.delta])
    wheels[:, 12:] = found.rate
    truth[:, 0], truth[:, 9:12] = found.truth_s, found.pose
    rows = table[np.argsort(table[:, 0], kind="stable")]
    lines = [
        ",".join("" if math.isnan(value) else repr(value) for value in row)
        for row in (rows if order is None else rows[order]).tolist()
    ]
    path.write_text("\n".join([",".join(COLUMNS), *lines, ""]))
    return path
