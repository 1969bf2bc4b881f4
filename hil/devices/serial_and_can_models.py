"""Base classes of models at a serial port and of models on a CAN bus."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import Any, ClassVar

from hil.config.can_bus import SEARCH_S
from hil.core.clock import Clock
from hil.core.device import DeviceModel, Found, Search, can_open, import_object

_PROBE_S = 0.9
_BY_NAME, _NAMES = 170, 80


class SerialModel(DeviceModel):
    """A model at a serial port; its table has `port` and `baud`.

    Its chip is a `hil.fakes.serial_chip.SerialChip` with `build(request)`.

    Attributes:
        probe_bauds: baud rates at which discovery probes for it: its driver then has the class method
            `identify_only(config, clock)`, which returns an identity or None and changes no setting. Empty
            where discovery skips it.
    """

    wire = "serial"
    probe_bauds: ClassVar[tuple[int, ...]] = ()

    def emulate(self, request: Any) -> Any:
        """The chip behind a USB serial adapter."""
        from hil.devices.emulated_device import on_serial_line

        return on_serial_line(request, import_object(self.chip).build(request))

    def probe(self, port: str, clock: Clock) -> Found | None:
        """Probe a port at each of the baud rates, for a short time."""
        default = self.config.model_fields["baud"].default
        for baud in self.probe_bauds:
            config = self.config(port=port, baud=baud, open_timeout_s=_PROBE_S / len(self.probe_bauds))
            identity = import_object(self.driver).identify_only(config, clock)
            if identity is not None:
                message = ", ".join(f"{key} {value}" for key, value in identity.items() if key != "port")
                table = {"port": port} if baud == default else {"port": port, "baud": baud}
                return Found(
                    table,
                    notes=(f"{self.title.partition(' on ')[0]} at {port}: {message}",) if message else (),
                )
        return None

    @property
    def can_probe(self) -> bool:
        """Whether discovery probes serial ports for it."""
        return bool(self.probe_bauds) or super().can_probe


class CanModel(DeviceModel):
    """A model on a CAN bus; its table is a `hil.config.can_bus.CanConfig`.

    Its chip has `build(request, channel)`: a node on an emulated channel.

    Attributes:
        subnet: third byte of the multicast group at which `hil emulate` serves it; 0: by its name.
        listens: True if it receives frames from clients.
        printed: keys of its table that `hil emulate` prints beside bus and bit rate.
    """

    wire = "can"
    subnet: ClassVar[int] = 0
    listens: ClassVar[bool] = False
    printed: ClassVar[tuple[str, ...]] = ()

    def emulate(self, request: Any) -> Any:
        """Emulate the node on a bus of its own."""
        from hil.devices.emulated_can import channel_of, on_can

        channel = channel_of(request)
        node = import_object(self.chip).build(request, channel)
        return on_can(
            request,
            channel,
            subnet=self.subnet or _BY_NAME + zlib.crc32(f"{self.kind}.{self.name}".encode()) % _NAMES,
            dbc=getattr(request.config, "dbc_path", ""),
            listens=self.listens,
            printed={key: getattr(request.config, key) for key in self.printed},
            begin=getattr(node, "begin_in_use", lambda: None),
        )

    def search(self, search: Search) -> Found | None:
        """Open the driver on the CAN buses that were named, or that the system has; it only listens."""
        from hil.links.can_bus import detected

        named = [config for config in search.given.get(self.kind, ()) if isinstance(config, self.config)]
        for config in named or detected(self.config, open_timeout_s=SEARCH_S):
            search.say(f"listening for {self.title} on {config.interface}:{config.channel}")
            if can_open(self.make_driver(config, search.clock)):
                return Found(config.table())
        return None

    def connection(self, endpoint: Mapping[str, Any]) -> Mapping[str, Any]:
        """Table keys that reach an emulated node: its bus, and the keys `printed`."""
        from hil.devices.emulated_can import where

        return where(endpoint, self.printed)
