"""Configuration of the OptiTrack motion capture over NatNet (`[mocap]` of the bench file)."""

import ipaddress
from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator

from hil.config.assumed_parameters import Parameter, instead, turned
from hil.config.device import DeviceConfig
from hil.config.field_types import Delay, Freshness, NetworkPort, Patience, PosesAgain, Within

Body = Annotated[str | int, Within(0, 2**31 - 1, "a streaming id of Motive")]
_OTHER_AXES = tuple(
    (f"{what}_rotation_wxyz", turned(axis, by_deg)((1.0, 0.0, 0.0, 0.0)))
    for what in ("plane", "body")
    for axis, by_deg in (("z", 10.0), ("z", -20.0), ("z", 180.0), ("x", 10.0), ("y", 90.0))
)
"""A plane calibrated, or a rigid body defined, with other axes than wall and robot have."""


class MocapConfig(DeviceConfig):
    """Address of the capture server, and limits for its poses.

    Attributes:
        server: IPv4 address of the computer that runs Motive.
        command_port, data_port: UDP ports of the server, as set in Motive's streaming pane.
        multicast: group that Motive streams to; None for unicast.
        local_address: IPv4 address of the interface to use; any when None.
        body: name or streaming id of the robot's rigid body.
        natnet_version: bit stream to ask for (unicast, NatNet 4 servers); the server's own when None.
        up_axis: Motive's streaming setting; with `y` the axes (x, y, z) become (x, -z, y), so that z
            points out of the calibrated ground plane: the wall.
        transit_s: smallest time from the server's sending to the host.
        jump_distance_m, jump_angle_rad: largest step beside what `max_speed_m_s` and
            `max_rate_rad_s` explain; anything larger is a swapped body.
        max_speed_m_s, max_rate_rad_s: fastest motion of the robot.
        reaccept_after: consistent poses after a jump before they are trusted again.
        stale_after_s: age after which poses are marked stale.
        stuck_after_s: time after which bit-identical poses are marked frozen.
        keepalive_s: time between signs of life to a unicast server.
        reconnect_after_s: silence after which the connection is requested again.
        open_timeout_s: longest wait for the server and the rigid body.
        fail_after_s: uninterrupted silence (or garbage) that raises.
    """

    CHOSEN_BY_EMULATOR: ClassVar[tuple[str, ...]] = ("command_port", "data_port")
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("up_axis", (instead("z"),), ("servos",)),
        Parameter("body", (), ("imu", "tracker", "servos"), _OTHER_AXES),
    )

    model: Literal["natnet"] = "natnet"
    server: str = "127.0.0.1"
    command_port: NetworkPort = 1510
    data_port: NetworkPort = 1511
    multicast: str | None = None
    local_address: str | None = None
    body: Body = "robot"
    natnet_version: str | None = Field(None, pattern=r"^[34]\.\d$")
    up_axis: Literal["y", "z"] = "y"
    transit_s: Delay = 0.0002
    jump_distance_m: Annotated[float, Within(0.001, 1.0, "a jump of 1 m is one")] = 0.03
    jump_angle_rad: Annotated[float, Within(0.001, 1.0, "a jump of 1 rad is one")] = 0.1
    max_speed_m_s: Annotated[float, Within(0.01, 5.0, "the robot drives 0.13 m/s")] = 0.5
    max_rate_rad_s: Annotated[float, Within(0.01, 20.0, "the robot turns at 0.8 rad/s")] = 2.0
    reaccept_after: PosesAgain = 10
    stale_after_s: Freshness = 0.5
    stuck_after_s: Freshness = 0.2
    keepalive_s: Patience = 1.0
    reconnect_after_s: Patience = 0.5
    open_timeout_s: Patience = 3.0
    fail_after_s: Patience = 2.0

    @field_validator("server", "multicast", "local_address")
    @classmethod
    def _address(cls, value: str | None) -> str | None:
        if value is not None:
            try:
                ipaddress.IPv4Address(value)
            except ValueError:
                raise ValueError(f"{value!r} is not an IPv4 address") from None
        return value

    @field_validator("multicast")
    @classmethod
    def _group(cls, value: str | None) -> str | None:
        if value is not None and not ipaddress.IPv4Address(value).is_multicast:
            raise ValueError(f"{value} is not a multicast group, for example 239.255.42.99")
        return value

    @field_validator("body")
    @classmethod
    def _named(cls, value: str | int) -> str | int:
        if value == "":
            raise ValueError("body needs a name or a streaming id")
        return value
