"""Topic mapping of another robot's bag, in TOML: wheels or twist, ground truth, IMU and camera.

::

    schema = 2
    body_frame = "base_link"                   # optional: the robot in /tf_static
    [wheels]
    topic = "/joint_states"                    # sensor_msgs/JointState, rad
    drive = ["fl_drive", "bl_drive", "br_drive", "fr_drive"]
    steer = ["fl_steer", "bl_steer", "br_steer", "fr_steer"]
    drive_sign = [1, 1, 1, 1]                  # optional, as are the next two
    steer_sign = [1, 1, 1, 1]
    steer_zero_rad = [0.0, 0.0, 0.0, 0.0]
    [odometry]                                 # in place of [wheels]: the body's velocity, of any drive train
    topic = "/odom"                            # Odometry, TwistWithCovarianceStamped or TwistStamped
    [truth]                                    # optional for `hil replay` and `hil export`
    topic = "/mocap/pose"                      # PoseStamped, PoseWithCovarianceStamped or Odometry
    up_axis = "z"                              # optional, as are the next two
    mount_position_m = [0.0, 0.0, 0.0]
    mount_rotation_wxyz = [1.0, 0.0, 0.0, 0.0]
    [imu]                                      # optional: sensor_msgs/Imu
    topic = "/imu/data"
    frame = "imu_link"                         # mount from /tf_static, or mount_rotation_wxyz
    latency_s = 0.0                            # its stamps are late by so much, or "fit"
    gravity = "in_force"                       # "removed" where the driver has taken it out
    [tracker]                                  # optional: an odometry with a frame of its own
    topic = "/vio/odometry"                    # PoseStamped, PoseWithCovarianceStamped or Odometry
    mount_position_m = [0.0, 0.0, 0.0]         # or frame, as above
    mount_rotation_wxyz = [1.0, 0.0, 0.0, 0.0]
    scale = 1.0
    latency_s = 0.0

For CSV files the table `[columns]` takes the place of all others, see `hil.datasets.column_map`.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError, field_validator, model_validator

from hil.config.device import Position
from hil.config.field_types import UnitQuaternion, Within
from hil.core.errors import ConfigError
from hil.datasets.column_map import ColumnMap, Four, Names, Signs, Table
from hil.support.file_reading import read_toml


class WheelTopic(Table):
    """Joints of the wheels, order FL, BL, BR, FR."""

    topic: str
    drive: Names
    steer: Names
    drive_sign: Signs = (1, 1, 1, 1)
    steer_sign: Signs = (1, 1, 1, 1)
    steer_zero_rad: Four = (0.0, 0.0, 0.0, 0.0)

    @field_validator("steer_zero_rad")
    @classmethod
    def _in_radians(cls, zeros: Four) -> Four:
        if not all(abs(zero) <= math.tau for zero in zeros):
            raise ValueError(f"{list(zeros)} goes beyond 2 pi, a whole turn: give radians, not degrees")
        return zeros

    @property
    def joints(self) -> tuple[str, ...]:
        """Drive joints, then steering joints."""
        return (*self.drive, *self.steer)

    @model_validator(mode="after")
    def _each_joint_once(self) -> WheelTopic:
        for k, joint in enumerate(self.joints):
            if (first := self.joints.index(joint)) < k:
                keys = ["steer" if i >= len(self.drive) else "drive" for i in (first, k)]
                what = f"{keys[0]} names" if keys[0] == keys[1] else "drive and steer both name"
                twice = " twice" if keys[0] == keys[1] else ""
                raise ValueError(
                    f"{what} the joint {joint!r}{twice}: give each wheel its own, order FL, BL, BR, FR"
                )
        return self


class OdometryTopic(Table):
    """Twist of the body (x forward, y left, z upwards; m/s, rad/s) by the odometry of any drive train."""

    topic: str


class TruthTopic(Table):
    """Ground truth of a body fixed to the robot, in a frame whose up axis is normal to the surface.

    The keys are those of the bench file: `up_axis` as in `[mocap]`, the mount as of a camera.

    Attributes:
        topic: topic of the poses.
        up_axis: `y` where poses and body have their y axis upwards, as Motive streams by default.
        mount_position_m, mount_rotation_wxyz: pose of the body's frame on the robot.
    """

    topic: str
    up_axis: Literal["y", "z"] = "z"
    mount_position_m: Position = (0.0, 0.0, 0.0)
    mount_rotation_wxyz: UnitQuaternion = (1.0, 0.0, 0.0, 0.0)


class SensorTopic(Table):
    """Topic of a sensor on the robot.

    Attributes:
        topic: topic of the messages.
        frame: frame of the sensor, whose mount is then that of `/tf_static`.
        mount_position_m, mount_rotation_wxyz: pose of the sensor's frame on the robot, without `frame`.
        latency_s: time by which its stamps are late, s; `fit` for the time at which its motion is most like
            that of the wheels.
    """

    topic: str
    frame: str | None = None
    mount_position_m: Position = (0.0, 0.0, 0.0)
    mount_rotation_wxyz: UnitQuaternion = (1.0, 0.0, 0.0, 0.0)
    latency_s: Annotated[float, Within(-0.5, 0.5, "s; more is another clock")] | Literal["fit"] = 0.0

    @model_validator(mode="after")
    def _one_mount(self) -> SensorTopic:
        given = self.model_fields_set & {"mount_position_m", "mount_rotation_wxyz"}
        if self.frame is not None and given:
            raise ValueError(f"frame and {min(given)} both give the mount: leave one out")
        return self


class ImuTopic(SensorTopic):
    """`sensor_msgs/Imu`: rates and specific force.

    Attributes:
        gravity: `in_force` where the acceleration is the specific force (REP 145), 9.8 m/s^2 at rest;
            `removed` where the driver has taken gravity out.
    """

    gravity: Literal["in_force", "removed"] = "in_force"


class TrackerTopic(SensorTopic):
    """Poses of a camera or of another odometry, in a frame of its own.

    Attributes:
        scale: distance that it reports over the true distance.
    """

    scale: Annotated[float, Within(0.5, 2.0, "reported over true distance")] = 1.0


class TopicMap(Table):
    """Topics of a bag: wheels, or the twist by them, ground truth, IMU and camera.

    Attributes:
        columns: columns of a CSV file, in place of all topics.
        body_frame: frame of the robot in `/tf_static`: x forward, y left, origin between the wheels.
    """

    schema_version: Literal[2] = Field(alias="schema")
    body_frame: str = "base_link"
    wheels: WheelTopic | None = None
    odometry: OdometryTopic | None = None
    columns: ColumnMap | None = None
    truth: TruthTopic | None = None
    imu: ImuTopic | None = None
    tracker: TrackerTopic | None = None

    @property
    def has_truth(self) -> bool:
        """Whether it names ground truth."""
        return self.truth is not None or (self.columns is not None and self.columns.has_truth)

    @property
    def topics(self) -> dict[str, str]:
        """Topic of each table that is there."""
        tables = {name: getattr(self, name) for name in ("wheels", "odometry", "truth", "imu", "tracker")}
        return {name: table.topic for name, table in tables.items() if table is not None}

    @model_validator(mode="after")
    def _topics_of_their_own(self) -> TopicMap:
        if self.columns is not None:
            if self.topics:
                raise ValueError(f"[columns] is for CSV, {', '.join(f'[{t}]' for t in self.topics)} for bags")
            return self
        if (self.wheels is None) == (self.odometry is None):
            how = "neither [wheels] nor [odometry]" if self.wheels is None else "[wheels] and [odometry]"
            raise ValueError(f"it has {how}: give the joints of four steered wheels, or a twist")
        table_of: dict[str, str] = {}
        for table, topic in self.topics.items():
            if topic in table_of:
                raise ValueError(
                    f"{table_of[topic]}.topic and {table}.topic are both {topic!r}: give each its own"
                )
            table_of[topic] = table
        return self


def read_topic_map(path: str | Path) -> TopicMap:
    """Read a topic mapping from a TOML file.

    Raises:
        ConfigError: the file is unreadable or wrong; lists every problem.
    """
    try:
        return TopicMap.model_validate(read_toml(Path(path)))
    except ValidationError as error:
        problems = tuple(
            ": ".join(filter(None, (".".join(map(str, e["loc"])), e["msg"].removeprefix("Value error, "))))
            for e in error.errors()
        )
        raise ConfigError(f"{path}: {len(problems)} problem(s)", problems=problems) from None
