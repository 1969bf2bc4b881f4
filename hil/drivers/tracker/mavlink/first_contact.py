"""Waits for the first messages of an odometry source, and reports what is wrong when none come."""

from typing import Any

from hil.config.mavlink import MavlinkTrackerConfig, udp_address
from hil.core.clock import Clock, nanoseconds
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.drivers.tracker.mavlink.session import Session
from hil.links.mavlink import messages as odometry_messages

_WAIT_NS = 2_000_000
_ACQUAINTANCE_NS = nanoseconds(1.2)
_ENOUGH_TRIPS = 3
_EXPECTED = "a stream of MAVLink ODOMETRY (331) or VISION_POSITION_ESTIMATE (102)"


def await_sender(
    session: Session, config: MavlinkTrackerConfig, clock: Clock, common: Any, device: str
) -> dict[str, str]:
    """Wait for odometry, then up to 1.2 s for heartbeat, version and clock of the sender.

    Returns:
        The identity of the sender.

    Raises:
        DeviceTimeoutError: no odometry arrives in time.
        DeviceError: it comes from another source, or in frames that cannot be used.
    """
    start_ns = clock.now_ns()
    deadline_ns = start_ns + nanoseconds(config.open_timeout_s)
    until_ns = deadline_ns
    first: Any = None
    while (now_ns := clock.now_ns()) < until_ns:
        session.exchange()
        if first is None and session.odometry:
            first, until_ns = session.odometry[0].message, now_ns + _ACQUAINTANCE_NS
        if first is not None and _is_known(session):
            break
        clock.sleep_until_ns(now_ns + _WAIT_NS)
    if first is None:
        raise _no_answer(session, config, device)
    frames = _frames(first, config, device)
    session.odometry.clear()
    return _identity(session, config, common, frames)


def silent(session: Session, config: MavlinkTrackerConfig, device: str, what: str) -> DeviceTimeoutError:
    """The error for missing poses, with `what` as its beginning."""
    reported = [f"{session.malformed} damaged pieces"] if session.malformed else []
    reported += [f"{session.lost} packets lost"] if session.lost else []
    reported += [session.trouble] if session.trouble else []
    return DeviceTimeoutError(
        device,
        "; ".join([what, *reported]),
        port=config.port,
        expected=_EXPECTED,
        remedy="check that the sender runs and tracks, and its cable or network; close and open the tracker "
        "to start again",
    )


def _is_known(session: Session) -> bool:
    return (
        session.heartbeat is not None and session.version is not None and session.sync.trips >= _ENOUGH_TRIPS
    )


def _no_answer(session: Session, config: MavlinkTrackerConfig, device: str) -> DeviceError:
    senders = {source for source, kinds in session.heard.items() if kinds & set(odometry_messages.POSES)}
    if senders:
        return DeviceError(
            device,
            f"odometry comes from {_listed(senders)} only",
            port=config.port,
            expected=_wanted(config),
            remedy="set tracker.system_id and tracker.component_id to the sender's, or leave them out",
        )
    if session.heard:
        kinds = sorted(set().union(*session.heard.values()))
        found = f"{_listed(set(session.heard))} sends {', '.join(kinds[:6])}, but no ODOMETRY"
        remedy = "switch the odometry output (message 331) of the sender on, and its tracking"
    elif session.packets:
        found = "what arrives is no MAVLink"
        remedy = (
            "another program sends to this port: find it (`ss -unp`) or choose another port in tracker.port"
            if udp_address(config.port)
            else f"check that the sender talks at {config.baud} baud, and that the port is the right one"
        )
    else:
        found = f"nothing arrives within {config.open_timeout_s:g} s"
        found += f" ({session.trouble})" if session.trouble else ""
        remedy = _where_to_look(config)
    return DeviceTimeoutError(device, found, port=config.port, expected=_EXPECTED, remedy=remedy)


def _where_to_look(config: MavlinkTrackerConfig) -> str:
    address = udp_address(config.port)
    if address is None:
        return "check power, cable (TX to RX) and tracker.port"
    if address.role == "udpin":
        return f"have the sender send to UDP port {address.port} of this computer; no firewall may close it"
    return f"check that the sender listens at {address.host}, UDP port {address.port}"


def _frames(message: Any, config: MavlinkTrackerConfig, device: str) -> str:
    """The frames of the poses in words; raises `DeviceError` when they cannot be used."""
    frame, child = (
        odometry_messages.frame_name(message.frame_id),
        odometry_messages.frame_name(message.child_frame_id),
    )
    usable = odometry_messages.axes_of(message.frame_id, message.child_frame_id) is not None
    if usable and config.frame in (None, frame):
        return f"{frame}, {child}"
    wanted = config.frame or "LOCAL_FRD, LOCAL_FLU, LOCAL_NED or LOCAL_ENU"
    raise DeviceError(
        device,
        f"the pose is given in {frame}, the twist in {child}",
        port=config.port,
        expected=f"the pose in {wanted}, the twist in BODY_FRD or in the frame of the pose",
        remedy="set the frames of the sender's odometry to MAV_FRAME_LOCAL_FRD and MAV_FRAME_BODY_FRD, or "
        "tracker.frame to what it sends",
    )


def _identity(session: Session, config: MavlinkTrackerConfig, common: Any, frames: str) -> dict[str, str]:
    assert session.source is not None
    system, component = session.source
    found = {"model": "MAVLink odometry", "system": str(system), "component": _component(common, component)}
    if session.heartbeat is not None:
        kind = common.enums["MAV_TYPE"].get(session.heartbeat.type)
        found["type"] = kind.name.removeprefix("MAV_TYPE_").lower() if kind else str(session.heartbeat.type)
    if session.version is not None:
        number = session.version.flight_sw_version
        found["firmware"] = ".".join(str(number >> shift & 0xFF) for shift in (24, 16, 8))
        found["serial"] = f"{session.version.uid:016x}"
    return {**found, "frames": frames, "port": config.port}


def _component(common: Any, number: int) -> str:
    known = common.enums["MAV_COMPONENT"].get(number)
    return f"{number} ({known.name.removeprefix('MAV_COMP_ID_').lower()})" if known else str(number)


def _listed(sources: set[tuple[int, int]]) -> str:
    return ", ".join(f"system {system} component {component}" for system, component in sorted(sources))


def _wanted(config: MavlinkTrackerConfig) -> str:
    system = "any system" if config.system_id is None else f"system {config.system_id}"
    component = "any component" if config.component_id is None else f"component {config.component_id}"
    return f"{system}, {component}"
