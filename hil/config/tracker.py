"""Configuration of the T265 tracking camera (`[tracker]` of the bench file)."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from hil.config.device import Position, TrackerConfig
from hil.config.field_types import (
    Freshness,
    MostKept,
    NetworkPort,
    Patience,
    PosesAgain,
    Strict,
    Switch,
    Within,
)


class FeedEndpoint(Strict):
    """Address at which an emulated camera streams its poses (`hil emulate` prints it).

    Attributes:
        host: IPv4 address or name.
        port: UDP port.
    """

    host: str = Field("127.0.0.1", min_length=1)
    port: NetworkPort


class T265Config(TrackerConfig):
    """Choice of the camera, and limits for its poses.

    Attributes:
        serial: serial number of the camera to use; any T265 when None.
        firmware: versions that it may have; `hil doctor` refuses others. Its library gives it its own.
        endpoint: address of an emulated camera in another process instead of the USB library.
        mount_position_m, mount_rotation_wxyz: camera (robot axes) in the body (arXiv 2509.04016);
            applied by the alignment.
        scale: distance that the camera reports over the true distance; the alignment divides by it.
        scale_sigma: standard uncertainty of `scale` where it was measured (`tracker_extrinsics`): the
            estimator's prior for the scale error that is left, unless `estimator.tracker.scale_sigma` is
            given, too.
        latency_s: smallest time from exposure to the host, which no host clock can see.
        jump_distance_m, jump_angle_rad: largest step beside what `max_speed_m_s` and
            `max_rate_rad_s` explain; anything larger is a relocalisation.
        max_speed_m_s, max_rate_rad_s: fastest motion of the robot.
        reaccept_after: consistent poses after a jump before they are trusted again.
        mapping: true if the camera keeps a map of what it sees; the next three keys need one. Leave it off
            for a robot that follows a path: a pose that jumps is no motion.
        relocalisation: true if the camera searches for its position in that map.
        pose_jumping: true if its poses jump where the map corrects them.
        map_preservation: true if it keeps the map from one start to the next.
        wheel_odometry: true if it gets the velocity of the wheels, which makes it robust on wheels. Camera
            and wheels are then no longer independent measurements.
        wheel_sigma_m_s: standard uncertainty of that velocity, per axis; from the noise of the wheels
            (`estimator.wheels`) at the highest speed when None.
        stale_after_s: age after which poses are marked stale.
        stuck_after_s: time after which bit-identical poses (20 of them) are marked frozen.
        connect_timeout_s: longest wait for the camera to be there: it is given its firmware, which takes
            seconds, each time it is plugged in.
        open_timeout_s: longest wait for the first pose.
        fail_after_s: uninterrupted silence (or garbage) that raises.
        queue_length: number of poses kept between two reads; the oldest are dropped and counted.
    """

    model: Literal["t265"] = "t265"
    serial: str | None = None
    firmware: tuple[str, ...] = ("0.2.0.951",)
    endpoint: FeedEndpoint | None = None
    mount_position_m: Position = (0.1489, 0.0092, 0.0666)
    jump_distance_m: Annotated[float, Within(0.001, 1.0, "a jump of 1 m is one")] = 0.03
    jump_angle_rad: Annotated[float, Within(0.001, 1.0, "a jump of 1 rad is one")] = 0.05
    max_speed_m_s: Annotated[float, Within(0.01, 5.0, "the robot drives 0.13 m/s")] = 0.5
    max_rate_rad_s: Annotated[float, Within(0.01, 20.0, "the robot turns at 0.8 rad/s")] = 2.0
    reaccept_after: PosesAgain = 20
    mapping: Switch = False
    relocalisation: Switch = False
    pose_jumping: Switch = False
    map_preservation: Switch = False
    wheel_odometry: Switch = False
    wheel_sigma_m_s: (
        Annotated[float, Within(1e-4, 0.1, "the robot drives 0.13 m/s, a servo reads 0.003 m/s")] | None
    ) = None
    stale_after_s: Freshness = 0.5
    stuck_after_s: Freshness = 0.1
    connect_timeout_s: Patience = 10.0
    open_timeout_s: Patience = 5.0
    fail_after_s: Patience = 2.0
    queue_length: MostKept = 1024

    @model_validator(mode="after")
    def _one_mind(self) -> T265Config:
        """Refuse keys that need the map without `mapping`, and `wheel_sigma_m_s` without `wheel_odometry`."""
        of_the_map = [k for k in ("relocalisation", "pose_jumping", "map_preservation") if getattr(self, k)]
        if of_the_map and not self.mapping:
            raise ValueError(
                f"{' and '.join(of_the_map)} = true without a map: set mapping = true, or leave it out"
            )
        if self.wheel_sigma_m_s is not None and not self.wheel_odometry:
            raise ValueError(
                "wheel_sigma_m_s needs wheel odometry: set wheel_odometry = true, or leave it out"
            )
        return self
