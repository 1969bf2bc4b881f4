"""Configuration of a tracker that sends its poses by MAVLink (`[tracker]` with `model = "mavlink"`)."""

import re
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import AfterValidator

from hil.config.device import Position, TrackerConfig
from hil.config.field_types import Baud, Freshness, MostKept, Patience, PosesAgain, Within

PoseFrame = Literal["LOCAL_FRD", "LOCAL_FLU", "LOCAL_NED", "LOCAL_ENU"]
BodyAxes = Literal["FRD", "FLU"]
MavlinkId = Annotated[int, Within(1, 255, "0 addresses all")]
Percent = Annotated[int, Within(1, 100, "percent")]

_UDP = re.compile(r"(?P<role>udpin|udpout):(?P<host>[\w.-]+):(?P<port>\d{1,5})")
_OTHER_FORMS = re.compile(r"(udp|udpin|udpout|udpbcast|tcp|tcpin|tcpout|mcast|wsserver|ws)[:/]")


class UdpAddress(NamedTuple):
    """Address at which datagrams are awaited (`udpin`), or at which the sender awaits them (`udpout`)."""

    role: str
    host: str
    port: int


def udp_address(port: str) -> UdpAddress | None:
    """The address of a UDP connection; None for a serial port."""
    match = _UDP.fullmatch(port)
    return None if match is None else UdpAddress(match["role"], match["host"], int(match["port"]))


def _connection(port: str) -> str:
    address = udp_address(port)
    if address is not None and not 1 <= address.port <= 65535:
        raise ValueError(f"UDP port {address.port} must lie within 1 .. 65535")
    if address is None and (not port or _OTHER_FORMS.match(port)):
        raise ValueError(
            "must be udpin:HOST:PORT (wait for the sender), udpout:HOST:PORT (speak first), a serial port, "
            "or a pyserial URL such as socket://HOST:PORT"
        )
    return port


class MavlinkTrackerConfig(TrackerConfig):
    """Address of the visual-inertial computer, and limits for its poses.

    Attributes:
        port: `udpin:HOST:PORT` waits for a sender, `udpout:HOST:PORT` speaks to one first; or a serial port.
        baud: bits per second of a serial port. 100 poses per second need at least 460800.
        rate_hz: poses per second that the sender is set to.
        system_id, component_id: MAVLink ids of the sender; those of the first one that sends odometry when
            None.
        frame: frame that the poses must be given in; any that is understood when None.
        body_axes: axes that the pose's quaternion turns. None follows the frames: front-right-down, but
            front-left-up where the twist is given in a frame with z up.
        least_quality: quality (percent) below which a pose has low confidence and is not used.
        good_quality: quality (percent) from which a pose is trusted fully. An unknown quality (0) is below.
        mount_position_m, mount_rotation_wxyz: camera (robot axes) in the body; applied by the alignment.
        latency_s: smallest time from exposure to the host. It is used where the sender answers no TIMESYNC.
        jump_distance_m, jump_angle_rad: largest step beside what `max_speed_m_s` and
            `max_rate_rad_s` explain; anything larger is a relocalisation.
        max_speed_m_s, max_rate_rad_s: fastest motion of the robot.
        reaccept_after: consistent poses after a jump or reset before they are trusted again.
        stale_after_s: age after which poses are marked stale.
        stuck_after_s: time after which bit-identical poses are marked frozen.
        open_timeout_s: longest wait for the first pose.
        fail_after_s: uninterrupted silence (or garbage) that raises.
        queue_length: number of poses kept between two reads; the oldest are dropped and counted.
    """

    CHOSEN_BY_EMULATOR: ClassVar[tuple[str, ...]] = ("port",)

    model: Literal["mavlink"] = "mavlink"
    port: Annotated[str, AfterValidator(_connection)] = "udpin:0.0.0.0:14550"
    baud: Baud = 921_600
    rate_hz: Annotated[float, Within(5.0, 1000.0, "poses per second of a visual-inertial computer")] = 100.0
    system_id: MavlinkId | None = None
    component_id: MavlinkId | None = None
    frame: PoseFrame | None = None
    body_axes: BodyAxes | None = None
    least_quality: Percent = 20
    good_quality: Percent = 50
    mount_position_m: Position = (0.1489, 0.0092, 0.0666)
    jump_distance_m: Annotated[float, Within(0.001, 1.0, "a jump of 1 m is one")] = 0.03
    jump_angle_rad: Annotated[float, Within(0.001, 1.0, "a jump of 1 rad is one")] = 0.05
    max_speed_m_s: Annotated[float, Within(0.01, 5.0, "the robot drives 0.13 m/s")] = 0.5
    max_rate_rad_s: Annotated[float, Within(0.01, 20.0, "the robot turns at 0.8 rad/s")] = 2.0
    reaccept_after: PosesAgain = 20
    stale_after_s: Freshness = 0.5
    stuck_after_s: Freshness = 0.5
    open_timeout_s: Patience = 5.0
    fail_after_s: Patience = 2.0
    queue_length: MostKept = 1024
