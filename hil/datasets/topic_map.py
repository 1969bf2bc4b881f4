"""Topic mapping of another robot's bag, in TOML: the joints of each wheel, and the topic of the ground truth.

::

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
    up_axis = "z"                              # optional, as are the next two
    mount_position_m = [0.0, 0.0, 0.0]
    mount_rotation_wxyz = [1.0, 0.0, 0.0, 0.0]
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from hil.config.device import Position
from hil.config.values import UnitQuaternion
from hil.core.errors import ConfigError
from hil.support.file_reading import read_toml

_Names = tuple[str, str, str, str]
_Zeros = tuple[float, float, float, float]
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
    steer_zero_rad: _Zeros = (0.0, 0.0, 0.0, 0.0)

    @field_validator("steer_zero_rad")
    @classmethod
    def _in_radians(cls, zeros: _Zeros) -> _Zeros:
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


class TruthTopic(_Strict):
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


class TopicMap(_Strict):
    """Topics of wheels and ground truth in a bag."""

    schema_version: Literal[1] = Field(alias="schema")
    wheels: WheelTopic
    truth: TruthTopic

    @model_validator(mode="after")
    def _truth_of_its_own(self) -> TopicMap:
        if self.truth.topic == self.wheels.topic:
            raise ValueError(
                f"wheels.topic and truth.topic are both {self.truth.topic!r}: name the topic of the poses"
            )
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
