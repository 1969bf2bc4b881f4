"""Connects the emulated capture server: by datagrams in this process, or on real UDP sockets."""

from typing import Any

from hil.core.device import Connection
from hil.fakes.emulated_device import EmulatedDevice, EmulationRequest, Wired
from hil.fakes.mocap.natnet.chip import NatNetServer
from hil.fakes.mocap.natnet.udp import NatNetTransport

_MOTIVE_PORTS = {"command_port": 1510, "data_port": 1511}
_MOTIVE_GROUP = "239.255.42.99"


def emulated(model: Any, request: EmulationRequest) -> EmulatedDevice:
    """The server at the ports of its table, at Motive's own, or at free ones.

    Args:
        model: model of the bench file.
        request: world and table of the bench file.
    """
    server, config = NatNetServer.build(request), request.config
    if request.standard_ports:
        server.offered_group = _MOTIVE_GROUP
    chosen = {key: getattr(config, key) for key in _MOTIVE_PORTS if key in config.model_fields_set}
    ports = _MOTIVE_PORTS if request.standard_ports else chosen
    return Wired(
        lambda: Connection(parts={"datagrams": server.datagrams}), lambda: NatNetTransport(server, **ports)
    )
