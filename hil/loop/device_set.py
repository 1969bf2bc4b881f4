"""All devices of a bench as one thing: opened in order, drained once per cycle, always closed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, cast

from hil.core.clock import Clock
from hil.core.errors import DeviceError
from hil.core.interfaces import Actuators, Device, Holding, Sensor
from hil.core.registry import kinds
from hil.core.signals import KINDS, Inputs

_NOTHING: tuple[Any, ...] = ()
_UNHEARD = {kind: _NOTHING for kind in KINDS if kind != "servos"}
"""Samples of each kind of sensor that this package knows, in the order of `Inputs`, before it is read."""


@dataclass
class DeviceSet:
    """The devices of a bench.

    Attributes:
        clock: the bench clock.
        servos: what moves the robot; None where the bench has none.
        sensors: the other devices by kind, in the order in which they are opened and drained; what holds the
            robot (`DeviceKind.holds`) is among them, and comes first.
    """

    clock: Clock
    servos: Actuators | None = None
    sensors: Mapping[str, Sensor[Any]] = field(default_factory=dict)

    def get(self, kind: str) -> Any:
        """The device of a kind; None where the bench lacks it."""
        return self.sensors.get(kind, self.servos if kind == "servos" else None)

    def devices(self) -> tuple[Device, ...]:
        """Present devices: what holds the robot first, servos last: nothing moves before sensors answer."""
        return (*self.sensors.values(), *(() if self.servos is None else (self.servos,)))

    def open(self) -> None:
        """Open every device; on failure close those already open and raise the first error."""
        opened: list[Device] = []
        try:
            for device in self.devices():
                device.open()
                opened.append(device)
        except BaseException:
            for device in reversed(opened):
                device.close()
            raise

    def close(self) -> None:
        """Close every device, servos first, what holds the robot last; a fan blows on when it is closed."""
        for device in reversed(self.devices()):
            device.close()

    def read(self, cycle: int) -> Inputs:
        """Drain every device once, the others while the servos answer; `t_ns` is when the reading began."""
        t_ns = self.clock.now_ns()
        servos, read, health = self.servos, _NOTHING, _NOTHING
        if servos is not None:
            servos.ask()
        known = _UNHEARD.copy()
        added: dict[str, tuple[Any, ...]] = {}
        for kind, sensor in self.sensors.items():
            (known if kind in _UNHEARD else added)[kind] = sensor.read()
        if servos is not None:
            read, health = servos.read(), servos.read_health()
        values: tuple[Any, ...] = (cycle, t_ns, read, health, *known.values(), added)
        return Inputs(*values)

    def brace(self) -> None:
        """Have what holds the robot hold as firmly as it may. Never raises."""
        for kind, device in self.sensors.items():
            if kinds()[kind].holds_robot:
                cast("Holding[Any]", device).brace()

    def actuators(self) -> Actuators:
        """The servos, or a `DeviceError` when the bench has none."""
        if self.servos is None:
            raise DeviceError(
                "servos", "the bench has no servos", remedy="add a [servos] section to the bench file"
            )
        return self.servos
