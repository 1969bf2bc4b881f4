"""How an emulated device is built and connected: in this process for virtual time, or at the wire.

A model's `emulate` takes a `Setting` and gives an `EmulatedDevice`. Most are a chip behind a serial line
(`on_serial_line`); the others say themselves how they are reached.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from typing import Any, Protocol, TypeVar

from pydantic import TypeAdapter, ValidationError

from hil.devices.imperfections import impossible
from hil.fakes.serial_line import SerialLine
from hil.fakes.serial_pty import SerialPty
from hil.fakes.server import Face
from hil.fakes.wire import SerialChip
from hil.fakes.world import World
from hil.vocabulary.errors import ConfigError, did_you_mean
from hil.vocabulary.kinds import Connection

__all__ = ["EmulatedDevice", "Face", "Setting", "Wired", "on_serial_line"]

T = TypeVar("T")

_adapter: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)
"""Of a dataclass, made once: it takes longer to make than most devices."""


@dataclass(frozen=True)
class Setting:
    """What an emulated device is built from.

    Attributes:
        kind: of the device.
        config: its table of the bench file.
        given: its `[emulation.KIND]`, as it stands there; `options` makes something of it.
        world: plant, clock, faults and random streams.
        name: of its line or channel, unlike that of any other in this process.
        standard_ports: whether to serve it where such devices are usually found.
    """

    kind: str
    config: Any
    given: Mapping[str, Any]
    world: World
    name: str
    standard_ports: bool = False

    def options(self, imperfections: type[T], **known: Any) -> T:
        """True imperfections of the device.

        Args:
            imperfections: a dataclass with defaults.
            known: values of fields that follow from the bench; what the bench file says comes first.

        Raises:
            ConfigError: naming every key that is wrong.
        """
        names = [f.name for f in fields(imperfections)]  # type: ignore[arg-type]
        where = f"emulation.{self.kind}"
        problems = [
            f"{where}.{key}: unknown; {did_you_mean(key, names) or 'one of ' + ', '.join(names)}"
            for key in self.given
            if key not in names
        ]
        if not problems:
            problems = [f"{where}.{key}: {why}" for key, why in impossible(imperfections, self.given)]
        if not problems:
            try:
                made: T = _adapter(imperfections).validate_python({**known, **self.given})
                return made
            except ValidationError as error:
                problems = [
                    f"{where}.{'.'.join(map(str, e['loc']))}: {e['msg'].removeprefix('Value error, ')}"
                    for e in error.errors()
                ]
        raise ConfigError(f"[{where}]: {len(problems)} problem(s)", problems=tuple(problems))


class EmulatedDevice(Protocol):
    """An emulated device that nothing is connected to yet. Either of the two is called, once."""

    @abstractmethod
    def connect(self) -> Connection:
        """Make it reachable in this process, on the virtual clock."""

    @abstractmethod
    def serve(self) -> Face:
        """Make it reachable for any client, in real time."""


@dataclass
class Wired(EmulatedDevice):
    """An emulated device that is reached in two ways, each a function."""

    connecting: Callable[[], Connection]
    serving: Callable[[], Face]

    def connect(self) -> Connection:
        """As `EmulatedDevice.connect`."""
        return self.connecting()

    def serve(self) -> Face:
        """As `EmulatedDevice.serve`."""
        return self.serving()


@dataclass
class Begun(EmulatedDevice):
    """An emulated device that is told when it is connected in this process."""

    device: EmulatedDevice
    begin: Callable[[], None]

    def connect(self) -> Connection:
        """As `EmulatedDevice.connect`."""
        self.begin()
        return self.device.connect()

    def serve(self) -> Face:
        """As `EmulatedDevice.serve`."""
        return self.device.serve()


@dataclass
class SerialWired(EmulatedDevice):
    """A chip at the far end of a serial line: `hil://NAME`, or a PTY."""

    line: SerialLine
    told: Mapping[str, object] = field(default_factory=dict)

    def connect(self) -> Connection:
        """A pyserial URL."""
        line = self.line.open()
        return Connection({"port": f"hil://{line.name}"}, close=line.close)

    def serve(self) -> Face:
        """A PTY."""
        return SerialPty(self.line, dict(self.told))


def on_serial_line(
    setting: Setting, chip: SerialChip, *, latency_s: float = 0.001, told: Mapping[str, object] | None = None
) -> EmulatedDevice:
    """A chip behind a USB serial adapter.

    Args:
        setting: where it is built.
        chip: what is at the far end of the line.
        latency_s: latency timer of the adapter.
        told: what `hil emulate` prints beside the port; the table's baud rate by default.
    """
    line = SerialLine(setting.world, chip, name=setting.name, latency_s=latency_s)
    if told is None:
        told = {"baud": setting.config.baud} if hasattr(setting.config, "baud") else {}
    return SerialWired(line, told)
