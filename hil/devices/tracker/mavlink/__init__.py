"""Any visual-inertial computer that sends MAVLink `ODOMETRY` (331) or `VISION_POSITION_ESTIMATE` (102)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from hil.devices.tracker.mavlink.config import MavlinkTrackerConfig, udp_address
from hil.vocabulary.clock import Clock
from hil.vocabulary.errors import HilError
from hil.vocabulary.extras import is_installed
from hil.vocabulary.finding import Finding
from hil.vocabulary.interfaces import Sensor
from hil.vocabulary.kinds import Connection, DeviceModel, Found, Search
from hil.vocabulary.signals import TrackerSample

if TYPE_CHECKING:
    from hil.devices.emulated import EmulatedDevice, Face, Setting
    from hil.devices.looks import Watched
    from hil.devices.tracker.mavlink.computer import VisualInertialComputer

__all__ = ["MAVLINK"]

_GROUND_STATION = ("127.0.0.1", 14550)
_ANY_HOST = "0.0.0.0"
_LISTEN_S = 0.5
_OF_ITS_OWN = ("system_id", "component_id", "frame")


def _driver(config: MavlinkTrackerConfig, clock: Clock, link: Any = None) -> Sensor[TrackerSample]:
    from hil.devices.tracker.mavlink.driver import MavlinkTracker
    from hil.devices.tracker.mavlink.link import open_link

    return MavlinkTracker(config, clock, link=link or open_link)


def _imperfections() -> type[Any]:
    from hil.devices.tracker.mavlink.options import ComputerTruthOptions

    return ComputerTruthOptions


def _emulate(setting: Setting) -> EmulatedDevice:
    from hil.devices.emulated import Wired, on_serial_line
    from hil.devices.tracker.mavlink.computer import VisualInertialComputer
    from hil.devices.tracker.mavlink.network import ComputerLink
    from hil.devices.tracker.mavlink.options import ComputerTruthOptions
    from hil.devices.tracker.mavlink.serial import SerialComputer

    config: MavlinkTrackerConfig = setting.config
    wanted = {key: getattr(config, key) for key in _OF_ITS_OWN if getattr(config, key) is not None}
    computer = VisualInertialComputer(
        setting.world,
        options=setting.options(ComputerTruthOptions, rate_hz=config.rate_hz, **wanted),
        mount_position_m=config.mount_position_m,
        mount_rotation_wxyz=config.mount_rotation_wxyz,
    )
    if udp_address(config.port) is None:
        return on_serial_line(setting, SerialComputer(computer, baud=config.baud))
    return Wired(lambda: Connection(parts={"link": ComputerLink(computer)}), lambda: _face(setting, computer))


def _face(setting: Setting, computer: VisualInertialComputer) -> Face:
    """On UDP: where the bench file says, at the usual ground station's port, or at a free port."""
    from hil.devices.tracker.mavlink.face import MavlinkFace

    config: MavlinkTrackerConfig = setting.config
    address = udp_address(config.port) if "port" in config.model_fields_set else None
    if address is None:
        return MavlinkFace(computer, target=_GROUND_STATION if setting.standard_ports else None)
    if address.role == "udpout":
        return MavlinkFace(computer, host=address.host, port=address.port)
    host = _GROUND_STATION[0] if address.host == _ANY_HOST else address.host
    return MavlinkFace(computer, target=(host, address.port))


def _ask(port: str, clock: Clock) -> Found | None:
    """Whether somebody on a serial port sends odometry."""
    return _found(MavlinkTrackerConfig(port=port, open_timeout_s=_LISTEN_S), clock)


def _search(search: Search) -> Found | None:
    """Whether somebody sends odometry where the user says, or to the port of ground stations."""
    named = [c for c in search.given.get("tracker", ()) if isinstance(c, MavlinkTrackerConfig)]
    for config in named or [MavlinkTrackerConfig()]:
        search.say(f"listening for MAVLink odometry at {config.port}")
        found = _found(config.model_copy(update={"open_timeout_s": _LISTEN_S}), search.clock)
        if found is not None:
            return found
    return None


def _found(config: MavlinkTrackerConfig, clock: Clock) -> Found | None:
    """The sender that is heard; nobody without pymavlink."""
    if not is_installed("mavlink"):
        return None
    tracker = _driver(config, clock)
    try:
        tracker.open()
    except HilError:
        return None
    told = tracker.identity()
    tracker.close()
    ids = {"system_id": int(told["system"]), "component_id": int(told["component"].split()[0])}
    who = ", ".join(f"{key} {value}" for key, value in told.items() if key != "port")
    return Found({"port": config.port, **ids}, (f"tracker: {who}; set tracker.rate_hz to its rate",))


def _look(watched: Watched) -> Iterable[Finding]:
    findings: Iterable[Finding] = watched.device.findings(watched.samples, watched.watch_s)
    return findings


MAVLINK = DeviceModel(
    kind="tracker",
    name="mavlink",
    title="visual-inertial computer that sends MAVLink odometry",
    config=MavlinkTrackerConfig,
    driver=_driver,
    emulate=_emulate,
    imperfections=_imperfections,
    ask=_ask,
    ask_after=9,
    search=_search,
    look=_look,
)
