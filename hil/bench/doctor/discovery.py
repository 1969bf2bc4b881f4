"""Finds the devices of a bench and writes a ready `bench.toml`.

Serial ports are named by their USB serial number if the system has such links. Each port is probed for every
serial model of the registry, those that answer quickly first. Ports of devices that may hold the robot are
not probed (`hil.bench.doctor.protected_ports`). The requests that are
written to the other ports can be listed before.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomli_w
from serial.tools import list_ports

from hil.config.can_bus import CanConfig
from hil.config.mocap import MocapConfig
from hil.core.clock import Clock
from hil.core.device import DeviceModel, Found, Search
from hil.core.registry import base_of, kinds, may_be_twice
from hil.links.serial_url import BY_ID

_ORDINALS = ("first", "second", "third", "fourth", *(f"number_{k}" for k in range(5, 100)))
_WALL = {"surface": "melamine", "tilt_rad": 1.5708}
ASSUMED = "environment: a vertical wall is assumed, also of a robot on a stand; on a floor change both values"
"""Where the robot will work is the user's to say: a floor that is a wall would let it fall."""

Say = Callable[[str], None]


@dataclass
class Discovery:
    """Result of a search for devices.

    Attributes:
        sections: tables of a bench file, by the name of the device on the bench.
        parts: components of the devices (each servo of a bus), by kind.
        notes: remarks for the user.
        missing: searched places of each kind that did not answer.
        silent: ports that the user named, at which nothing answered.
        not_asked: ports to which nothing was written, and why.
    """

    sections: dict[str, dict[str, Any]] = field(default_factory=dict)
    parts: dict[str, tuple[Any, ...]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    missing: dict[str, str] = field(default_factory=dict)
    silent: list[str] = field(default_factory=list)
    not_asked: dict[str, str] = field(default_factory=dict)

    def take(self, model: DeviceModel, found: Found) -> None:
        """Add a device that was found; add a note if the bench has one of the kind already."""
        kind = kinds()[model.kind]
        table = {**({} if kind.models[0].name == model.name else {"model": model.name}), **found.table}
        self.notes += found.notes
        self.parts[kind.name] = (*self.parts.get(kind.name, ()), *found.parts)
        if kind.name not in self.sections:
            self.sections[kind.name] = table
        elif may_be_twice(kind):
            label = _ORDINALS[len([n for n in self.sections if base_of(n) == kind.name])]
            self.sections[kind.name]["name"] = kind.name
            self.sections[f"{kind.name}_{label}"] = {"name": label, **table}
            self.notes.append(f"{kind.name}: one more answered; give each a name that says where it is")
        else:
            self.notes.append(f"{kind.name}: one more answered, and is left out: {table}; a bench has one")

    def to_toml(self) -> str:
        """A bench file; its comments say what the user still has to check."""
        head = "".join(f"# {note}\n" for note in (ASSUMED, *self.notes))
        tree = {"schema": 1, "name": "my_bench", "environment": _WALL, **self._tables()}
        return head + tomli_w.dumps(tree)

    def _tables(self) -> dict[str, Any]:
        """Tables by kind; a list for several devices of a kind."""
        tables: dict[str, Any] = {}
        for name, table in self.sections.items():
            tables.setdefault(base_of(name), []).append(table)
        return {kind: found if len(found) > 1 else found[0] for kind, found in tables.items()}


def serial_ports() -> list[str]:
    """Serial ports of this computer, by their stable names if available."""
    return [stable_name(port.device) for port in list_ports.comports()]


def stable_name(port: str) -> str:
    """`/dev/serial/by-id/...` of a port, which names the adapter by its USB serial number."""
    if BY_ID.is_dir():
        for link in sorted(BY_ID.iterdir()):
            if str(link.resolve()) == port:
                return str(link)
    return port


def what_is_written() -> list[str]:
    """The requests that discovery writes to a serial port, in their order."""
    return [model.probe_writes for model in _asking() if model.probe_writes]


def _asking() -> list[DeviceModel]:
    """Models to probe on a serial port, those that answer quickly first."""
    models = (model for kind in kinds().values() for model in kind.models if model.can_probe)
    return sorted(models, key=lambda model: model.probe_order)


def discover(
    clock: Clock,
    *,
    ports: Sequence[str] | None = None,
    left_alone: Mapping[str, str] | None = None,
    given: Mapping[str, Sequence[Any]] | None = None,
    say: Say = lambda text: None,
    sysfs: Path = Path("/sys"),
) -> Discovery:
    """Search serial ports and all other places for devices.

    Args:
        clock: clock for timeouts.
        ports: serial ports or pyserial URLs; all of this computer when None.
        left_alone: ports among them to which nothing is written, and why.
        given: tables of devices to search that are not on a serial port (CAN buses to listen on, capture
            servers), by kind; by default those that the system lists.
        say: function that receives progress.
        sysfs: folder in which the kernel describes its devices.
    """
    found = Discovery(not_asked=dict(left_alone or {}))
    models = [model for kind in kinds().values() for model in kind.models]
    listed = serial_ports() if ports is None else list(ports)
    asked, asking = [port for port in listed if port not in found.not_asked], _asking()
    for port in asked:
        say(f"asking {port}")
        if not _ask_serial(found, port, clock, asking, say) and ports is not None:
            found.silent.append(port)
    places: dict[str, list[str]] = {name: [] for name in kinds()}
    for model in models:
        if model.can_search and model.kind not in found.sections:
            tried = places[model.kind]

            def tell(text: str, tried: list[str] = tried) -> None:
                say(text)
                tried.append(text)

            answer = model.search(Search(given or {}, clock, tell, sysfs, found.sections))
            if answer is not None:
                found.take(model, answer)
                say(f"found {model.title}")
    for name, kind in kinds().items():
        if name not in found.sections:
            where = f"asked {', '.join(asked)}" if asked else "no serial port was asked; name one with --port"
            found.missing[name] = "; ".join(_where(kind.models, where, places[name]))
    return found


def _where(models: Sequence[DeviceModel], ports: str, tried: Sequence[str]) -> list[str]:
    """Text with the places where a kind was searched, and the options for other places."""
    found = list(dict.fromkeys(tried))
    if any(model.can_probe for model in models):
        found.insert(0, ports)
    searched = [model for model in models if model.can_search]
    if not tried and searched:
        on_bus = any(issubclass(model.config, CanConfig) for model in searched)
        at = (
            "--mocap ADDRESS"
            if issubclass(searched[0].config, MocapConfig)
            else f"--at {searched[0].kind}.KEY=VALUE"
        )
        option = "--can INTERFACE:CHANNEL" if on_bus else at
        lacks = "this computer has no CAN bus" if on_bus else "no place is known where it could be"
        found.append(f"{lacks}; name one with {option}")
    return found or ["is not looked for; add its table to the bench file by hand"]


def _ask_serial(found: Discovery, port: str, clock: Clock, models: Sequence[DeviceModel], say: Say) -> bool:
    """Probe a port until the first model answers; return whether one did."""
    for model in models:
        answer = model.probe(port, clock)
        if answer is not None:
            found.take(model, answer)
            say(f"found {model.title} at {port}")
            return True
    return False
