"""Connects emulated devices on CAN: by a channel in this process, or by one that any client can open."""

import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from hil.core.device import Connection, import_object
from hil.fakes.can_bridge import CanTransport
from hil.fakes.can_channel import CanChannel
from hil.fakes.emulated_can_group import DEFAULT_GROUP, DEFAULT_PORT, first_of_host, leave_port, take_port
from hil.fakes.emulated_device import EmulatedDevice, EmulationRequest, Transport, Wired


def channel_of(request: EmulationRequest) -> CanChannel:
    """A bus of its own for an emulated device, with the bit rate of its table."""
    return CanChannel(request.world, request.name, bitrate=request.config.bitrate, device=request.kind)


def on_own_bus(model: Any, request: EmulationRequest) -> EmulatedDevice:
    """The node of a `hil.drivers.serial_and_can_models.CanModel` on a bus of its own.

    Args:
        model: model whose `chip` has `build(request, channel)`.
        request: its world and its table of the bench file.
    """
    channel = channel_of(request)
    node = import_object(model.chip).build(request, channel)
    return on_can(
        request,
        channel,
        subnet=model.multicast_subnet(),
        dbc=getattr(request.config, "dbc_path", ""),
        listens=model.listens,
        printed={key: getattr(request.config, key) for key in model.printed},
        begin=getattr(node, "begin_in_use", lambda: None),
    )


def on_can(
    request: EmulationRequest,
    channel: CanChannel,
    *,
    subnet: int,
    dbc: Path | str,
    listens: bool = False,
    printed: Mapping[str, object] | None = None,
    parts: Mapping[str, Any] | None = None,
    begin: Callable[[], None] = lambda: None,
) -> EmulatedDevice:
    """An emulated device on a channel.

    Args:
        request: its world and its table of the bench file.
        channel: its bus.
        subnet: third byte of its multicast group, so that devices of one process have different groups; at
            standard ports devices of one bus share one.
        dbc: path for clients; empty where there is none.
        listens: True if it receives frames from clients.
        printed: further values for clients.
        parts: parts of the connection in this process.
        begin: called when it is connected in this process; it may start the device before the bench opens it.
    """

    def connect() -> Connection:
        begin()
        opened = channel.open()
        values = {"interface": "hil", "channel": opened.name, "options": {}}
        return Connection(values, parts=dict(parts or {}), close=opened.close)

    def serve() -> Transport:
        config = request.config
        about: dict[str, Any] = {"dbc": dbc, "device": request.kind, "listens": listens, "printed": printed}
        if config.interface == "udp_multicast":
            at = {"port": DEFAULT_PORT, **config.options}
            return CanTransport(channel, address=config.channel, options=at, **about)
        if request.standard_ports:
            bus = (config.bus, config.bitrate)
            at = {"port": take_port(*bus, request.kind)}
            leave = partial(leave_port, *bus)
            return CanTransport(channel, address=DEFAULT_GROUP, options=at, at_close=leave, **about)
        address, right = f"239.74.{subnet}.{2 + os.getpid() % 250}", first_of_host()
        if right is None:
            return CanTransport(channel, address=address, **about)
        at = {"port": DEFAULT_PORT}
        return CanTransport(channel, address=address, options=at, at_close=right.close, **about)

    return Wired(connect, serve)
