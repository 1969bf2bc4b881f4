"""Finds the serial ports that discovery must not write to, since a device there may hold the robot.

A port does not show which device is behind it, and a propeller controller may treat any unknown byte as an
error and slow down. So discovery does not write to a port that another program has open, that a bench file
assigns to a device that holds the robot, or whose adapter is such a device by its USB ids.
"""

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from serial.tools import list_ports

from hil.config.loading import load_bench
from hil.core.device import DeviceModel
from hil.core.errors import ConfigError
from hil.core.registry import kinds
from hil.fan_daemon.server import running_daemons
from hil.links.serial_url import PORT_ERRORS, cannot_open, close_quietly, open_serial
from hil.support.file_reading import read_toml
from hil.support.port_users import named, programs_with

_BAUD = 115_200
_WAIT_S = 0.1


def ports_that_hold(named_files: Sequence[Path], folder: Path) -> dict[str, str]:
    """Devices that hold the robot and their serial ports, from bench files: description by device path.

    Args:
        named_files: bench files that the user named.
        folder: folder with further bench files; unreadable ones are ignored.

    Raises:
        ConfigError: a named file is not a bench file.
    """
    for path in named_files:
        load_bench(str(path))
    trees = {path: read_toml(path) for path in named_files}
    for path in sorted(folder.glob("*.toml")):
        with contextlib.suppress(ConfigError):
            trees.setdefault(path, read_toml(path))
    return {port: f"{noun} of {path}" for path, tree in trees.items() for port, noun in _holding(tree)}


def _holding(tree: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Port and noun of each device in a bench file that holds the robot and has a serial port."""
    for name, kind in kinds().items():
        table = tree.get(name)
        if not kind.holds_robot or not isinstance(table, dict) or table.get("backend", "real") != "real":
            continue
        model = next((m for m in kind.models if m.name == table.get("model")), kind.models[0])
        field = model.config.model_fields.get("port")
        port = table.get("port", None if field is None else field.default)
        if isinstance(port, str):
            yield _place(port), kind.noun


def _place(port: str) -> str:
    """Canonical device path of a port, with links resolved; a URL is unchanged."""
    return port if "://" in port else os.path.realpath(port)


def why_not_asked(port: str, holding: Mapping[str, str]) -> str:
    """Why discovery must not write to a port; empty if it may.

    Args:
        port: device path, a link to one, or a pyserial URL.
        holding: result of `ports_that_hold`.
    """
    if (why := why_it_holds(port, holding)) or "://" in port:
        return why
    if others := programs_with(port):
        return f"{named(others)} has it open"
    return _cannot_be_opened(port)


def why_it_holds(port: str, holding: Mapping[str, str]) -> str:
    """Why a port may belong to a device that holds the robot; empty for no reason.

    Args:
        port: device path, a link to one, or a pyserial URL.
        holding: result of `ports_that_hold`.
    """
    path = _place(port)
    if path in holding:
        return f"it is the port of the {holding[path]}"
    model = _by_usb(path)
    return f"by its USB ids it is a board that may be {model.title}" if model else ""


def _by_usb(path: str) -> DeviceModel | None:
    """The device model that holds a robot and has the USB ids of a port's adapter; None without one."""
    ids = next(((p.vid, p.pid) for p in list_ports.comports() if os.path.realpath(p.device) == path), None)
    holding = (model for kind in kinds().values() if kind.holds_robot for model in kind.models)
    return next((model for model in holding if ids in model.usb), None)


def _cannot_be_opened(port: str) -> str:
    try:
        close_quietly(open_serial(port, baud=_BAUD, timeout_s=_WAIT_S, write_timeout_s=_WAIT_S))
    except PORT_ERRORS as error:
        reported = cannot_open("discover", port, error, expected="")
        return f"{reported.message.partition(': ')[2]}; {reported.remedy}"
    return ""


def what_is_kept() -> list[str]:
    """Fans and propellers that daemons on this computer keep running now, each by bus and controller."""
    return running_daemons()
