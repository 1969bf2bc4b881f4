"""Looks for the devices of a bench and writes down what it found as a ready `bench.toml`.

Serial ports are named by their USB serial number where the system offers that. Each port is asked as a
BNO055 and then as a servo bus, at every baud rate with time-outs of our own.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import can
import tomli_w
from serial.tools import list_ports

from hil.config.encoders import EncodersConfig
from hil.config.imu import ImuConfig
from hil.config.mocap import MocapConfig
from hil.config.xh430 import MODEL_NUMBER, MODELS, model_text, models_text
from hil.drivers.encoders import As5045Encoders
from hil.drivers.imu import Bno055Imu
from hil.drivers.mocap import NatNetMocap
from hil.drivers.servos import FoundServo, scan
from hil.drivers.tracker.library import find_camera, realsense
from hil.vocabulary.clock import Clock
from hil.vocabulary.errors import HilError

_WALL = {"surface": "melamine", "tilt_rad": 1.5708}
_IMU_TIMEOUT_S = 0.9
_CAN_TIMEOUT_S = 0.5
_FIRMWARE_S = 10.0
_CAMERA_USB_IDS = {("03e7", "2150"), ("8087", "0b37")}  # T265 before and after it was given its firmware
_VELOCITY_MODE = 1
_WHEELS = 4

Say = Callable[[str], None]


@dataclass
class Discovery:
    """What answered. `sections` are tables of a bench file, `notes` what a person should know."""

    sections: dict[str, dict[str, Any]] = field(default_factory=dict)
    servos: tuple[FoundServo, ...] = ()
    notes: list[str] = field(default_factory=list)

    def to_toml(self, name: str = "my_bench") -> str:
        """A bench file; what still needs a person's eye stands in its comments."""
        head = "".join(f"# {note}\n" for note in self.notes)
        tree = {"schema": 1, "name": name, "environment": _WALL, **self.sections}
        return head + tomli_w.dumps(tree)


def serial_ports() -> list[str]:
    """Serial ports of this machine, by stable name where there is one."""
    return [stable_name(port.device) for port in list_ports.comports()]


def stable_name(port: str) -> str:
    """`/dev/serial/by-id/...` of a port, which names the adapter by its USB serial number."""
    folder = Path("/dev/serial/by-id")
    if folder.is_dir():
        for link in sorted(folder.iterdir()):
            if str(link.resolve()) == port:
                return str(link)
    return port


def discover(
    clock: Clock,
    *,
    ports: Sequence[str] = (),
    buses: Iterable[EncodersConfig] | None = None,
    mocap: MocapConfig | None = None,
    say: Say = lambda text: None,
    sysfs: Path = Path("/sys"),
) -> Discovery:
    """Ask everything that could be a device.

    Args:
        clock: for time-outs.
        ports: serial ports or pyserial URLs; all of this machine when empty.
        buses: CAN interfaces to listen on; those python-can detects when None.
        mocap: capture server to ask; none is asked when None.
        say: receives progress.
        sysfs: where the kernel tells of its devices.
    """
    found = Discovery()
    for port in ports or serial_ports():
        say(f"asking {port}")
        _ask_serial(found, port, clock, say)
    for config in _detected_buses() if buses is None else buses:
        say(f"listening on {config.interface}:{config.channel}")
        if _opens(As5045Encoders(config, clock)):
            found.sections["encoders"] = _given(config)
            break
    if mocap is not None:
        say(f"asking the capture server {mocap.server}")
        if _opens(NatNetMocap(mocap, clock)):
            found.sections["mocap"] = _given(mocap)
    _take_camera(found, clock, sysfs, say)
    return found


def _ask_serial(found: Discovery, port: str, clock: Clock, say: Say) -> None:
    """The IMU first: it answers within a second, a servo bus takes almost one for each baud rate."""
    if _opens(Bno055Imu(ImuConfig(port=port, open_timeout_s=_IMU_TIMEOUT_S), clock)):
        found.sections["imu"] = {"port": port}
        return
    servos: tuple[FoundServo, ...] = ()
    with contextlib.suppress(HilError):
        servos = scan(port, clock)
    if servos:
        found.servos += servos
        _take_servos(found, port, servos)


def _take_servos(found: Discovery, port: str, servos: Sequence[FoundServo]) -> None:
    bauds = sorted({s.baud for s in servos})
    section: dict[str, Any] = {"port": port, "baud": bauds[0]}
    models = sorted({s.model for s in servos})
    unknown = [m for m in models if m not in MODELS]
    if unknown or len(models) > 1:
        found.notes.append(
            f"servos of model {', '.join(map(model_text, models))} at {port}: "
            f"a bench needs eight of one model, {models_text()}"
        )
    elif models != [MODEL_NUMBER]:
        section["model_number"] = models[0]
    if len(bauds) > 1:
        found.notes.append(f"the servos at {port} have different baud rates {bauds}: use hil setup")
    drives = sorted(s.servo_id for s in servos if s.operating_mode == _VELOCITY_MODE)
    steers = sorted(s.servo_id for s in servos if s.operating_mode != _VELOCITY_MODE)
    if len(drives) == len(steers) == _WHEELS:
        section |= {"drive_ids": drives, "steer_ids": steers}
        found.notes.append("check that the IDs are in the order FL, BL, BR, FR: hil run bring_up")
    else:
        found.notes.append(
            f"{len(servos)} servo(s) at {port}, of which {len(drives)} in velocity mode; "
            "a bench needs four drives (velocity mode) and four steers: use hil setup"
        )
    found.sections["servos"] = section


def _opens(device: Any) -> bool:
    try:
        device.open()
    except HilError:
        return False
    device.close()
    return True


def _given(config: Any) -> dict[str, Any]:
    given: dict[str, Any] = config.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    return given


def _detected_buses() -> list[EncodersConfig]:
    found = can.detect_available_configs(["socketcan"])
    return [
        EncodersConfig(
            interface=str(c["interface"]), channel=str(c["channel"]), open_timeout_s=_CAN_TIMEOUT_S
        )
        for c in found
    ]


def _take_camera(found: Discovery, clock: Clock, sysfs: Path, say: Say) -> None:
    """The T265 that the camera library sees, where there is one; without the library nobody is asked."""
    try:
        library = realsense("tracker")
    except HilError:
        return
    patience_s = _FIRMWARE_S if _camera_plugged_in(sysfs) else 0.0
    say(f"looking for a camera{' (it may load its firmware for some seconds)' if patience_s else ''}")
    try:
        _, serial_number = find_camera(library, "tracker", clock, patience_s)
    except HilError as error:
        say(error.message)
        return
    found.sections["tracker"] = {"serial": serial_number}


def _camera_plugged_in(sysfs: Path) -> bool:
    """Whether USB shows a T265, with or without firmware; yes where the system does not tell."""
    if not (sysfs / "bus").is_dir():
        return True
    ids = set()
    for one in (sysfs / "bus/usb/devices").glob("*"):
        with contextlib.suppress(OSError):
            ids.add(tuple((one / key).read_text().strip() for key in ("idVendor", "idProduct")))
    return bool(ids & _CAMERA_USB_IDS)
