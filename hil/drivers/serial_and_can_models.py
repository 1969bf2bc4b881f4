"""Base classes of models at a serial port and of models on a CAN bus."""

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
        printed: keys of its table that `hil emulate` prints beside the port, as far as the table has them.
        probe_bauds: baud rates at which discovery probes for it: its driver then has the class method
            `identify_only(config, clock)`, which returns an identity or None and changes no setting. Empty
            where discovery skips it.
    """

    wire, emulation = "serial", "hil.fakes.emulated_device:behind_adapter"
    printed: ClassVar[tuple[str, ...]] = ("baud",)
    probe_bauds: ClassVar[tuple[int, ...]] = ()

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

    wire, emulation = "can", "hil.fakes.emulated_can:on_own_bus"
    subnet: ClassVar[int] = 0
    listens: ClassVar[bool] = False
    printed: ClassVar[tuple[str, ...]] = ()

    def multicast_subnet(self) -> int:
        """Third byte of its multicast group: `subnet`, or one that follows from its name."""
        return self.subnet or _BY_NAME + zlib.crc32(f"{self.kind}.{self.name}".encode()) % _NAMES

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
        keys = ("interface", "channel", "bitrate")
        options = {key: value for key, value in endpoint.items() if key not in (*keys, "dbc", *self.printed)}
        if endpoint["interface"] == "udp_multicast":
            options["hop_limit"] = 0
        own = {key: tuple(v) if isinstance(v := endpoint[key], list) else v for key in self.printed}
        return {**{key: endpoint[key] for key in keys}, "options": options, **own}
