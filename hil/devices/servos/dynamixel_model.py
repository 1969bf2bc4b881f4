"""Dynamixel X servos on their half-duplex bus, Protocol 2.0."""

from __future__ import annotations

from typing import Any

from hil.config.servos import ServosConfig
from hil.core.clock import Clock
from hil.core.device import Found, loaded
from hil.devices.link_models import SerialModel


class Dynamixel(SerialModel):
    """Eight servos on one bus; discovery looks for each of them, at every baud rate."""

    kind, name, title = "servos", "dynamixel", "Dynamixel X servos on RS-485 or TTL"
    config, probe_order = ServosConfig, 9
    driver, chip = "hil.drivers.servos:DynamixelServos", "hil.fakes.servos:ServoBus"
    probe_writes = "a ping of all Dynamixel servos, at each of their baud rates"

    def emulate(self, request: Any) -> Any:
        """The bus behind an adapter whose latency is that of the table."""
        from hil.devices.emulated_device import on_serial_line

        config: ServosConfig = request.config
        told = {"baud": config.baud, "ids": list(config.ids)}
        bus = loaded(self.chip).build(request)
        return on_serial_line(request, bus, latency_s=config.usb_latency_s, told=told)

    def probe(self, port: str, clock: Clock) -> Found | None:
        """Which servos answer."""
        from hil.devices.servos.discovery import ask

        return ask(port, clock)
