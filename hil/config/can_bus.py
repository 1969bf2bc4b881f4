"""Devices on CAN buses: bus and identifiers of each, and conflicts between devices."""

import os
from collections.abc import Iterable, Iterator, Mapping
from itertools import combinations
from typing import Annotated, Any, NamedTuple

from pydantic import Field

from hil.config.device import DeviceConfig
from hil.config.field_types import Patience, Within
from hil.support.emulated_can_mark import bus_name

_ONE_READER = ("canalystii", "cantact", "gs_usb", "robotell", "seeedstudio", "serial", "slcan")
"""Interfaces of python-can that open a serial or USB adapter: each frame goes to one of those who read it."""

SEARCH_S = 0.5
"""Time that discovery waits for a device on a bus."""


Option = Annotated[bool | int | float | str, Within(-1e12, 1e12, "no option of an interface is larger")]


class Claim(NamedTuple):
    """An identifier that no other device on the bus may have.

    Attributes:
        key: key of the device's table in the bench file.
        what: `VESC id`, `DroneCAN node` or `frame`; different ones do not conflict.
        number: the identifier.
    """

    key: str
    what: str
    number: int


class CanConfig(DeviceConfig):
    """A device on a CAN bus.

    Attributes:
        interface, channel, bitrate: bus and its bit rate, in the terms of python-can (`socketcan`, `can0`).
        options: further keyword arguments of the python-can interface (`host`, `port`, ...).
        open_timeout_s: longest wait for a first sample or report.
    """

    interface: str = Field("socketcan", min_length=1)
    channel: str = Field("can0", min_length=1)
    bitrate: Annotated[int, Within(10_000, 1_000_000, "bits per second of classical CAN")] = 500_000
    options: dict[str, Option] = Field(default_factory=dict)
    open_timeout_s: Patience = 1.0

    @property
    def bus(self) -> str:
        """Name of the bus in messages."""
        return bus_name(self.interface, self.channel, self.options)

    def waits_for_loop(self) -> bool:
        """True: frames arrive unrequested, and stay in a queue until the loop takes them."""
        return True

    def table(self, **found: Any) -> dict[str, Any]:
        """The device's table in a bench file, with what was found, without discovery's timeout."""
        waited = {"open_timeout_s"}
        reported = self.model_dump(mode="json", exclude_none=True, exclude_defaults=True, exclude=waited)
        return {**reported, **found}

    def claims(self) -> Iterable[Claim]:
        """Identifiers that belong to the device, as far as its table gives them."""
        return ()


def can_conflicts(devices: Mapping[str, DeviceConfig]) -> Iterator[tuple[str, str]]:
    """Dotted path and text of every conflict of identifiers or bit rates between devices of one bus.

    Args:
        devices: tables by name on the bench. An emulated device shares no bus with a real one.
    """
    tables = [(name, table) for name, table in devices.items() if isinstance(table, CanConfig)]
    for name, table in tables:
        for one, other in combinations(table.claims(), 2):
            yield from _quarrel(table.bus, name, one, name, other)
    yield from _shared_adapters([(name, table) for name, table in tables if table.backend == "real"])
    for (name, table), (rival, theirs) in combinations(tables, 2):
        if table.backend != theirs.backend or table.bus != theirs.bus:
            continue
        if table.backend == "real" and table.bitrate != theirs.bitrate:
            yield (
                f"{rival}.bitrate",
                f"{theirs.bitrate}, but {name}.bitrate = {table.bitrate}: all nodes of the bus {table.bus} "
                "have one bit rate",
            )
        for one in table.claims():
            for other in theirs.claims():
                yield from _quarrel(table.bus, name, one, rival, other)


def _shared_adapters(tables: list[tuple[str, CanConfig]]) -> Iterator[tuple[str, str]]:
    """Adapters for one reader that several devices have, or one whose daemon is another reader."""
    by_adapter: dict[tuple[str, str], list[str]] = {}
    for name, table in tables:
        if table.interface in _ONE_READER:
            readers = by_adapter.setdefault((table.interface, _place(table.channel)), [])
            readers += [name, f"the daemon of {name}"] if hasattr(table, "daemon_spec") else [name]
    for (interface, channel), readers in by_adapter.items():
        if len(readers) > 1:
            yield (
                f"{readers[0]}.interface",
                f"{interface!r} at {channel} gives each frame to one reader, and {', '.join(readers)} would "
                "each lose some: make the adapter a SocketCAN interface, which all share (with slcand where "
                'it is a serial port, docs/computer.md), and set interface = "socketcan" for each of them',
            )


def _place(channel: str) -> str:
    """An adapter without the rate of its serial port; a link stands for what it leads to."""
    port = channel.partition("@")[0]
    return os.path.realpath(port) if port.startswith("/") else port


def _quarrel(bus: str, name: str, one: Claim, rival: str, other: Claim) -> Iterator[tuple[str, str]]:
    if one[1:] == other[1:]:
        yield (
            f"{rival}.{other.key}",
            f"{other.what} {other.number} is that of {name}.{one.key}, too: on the bus {bus} each may be "
            "there once; change one of them",
        )
