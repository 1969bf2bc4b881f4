"""Connects an emulated fan: its controller on a CAN bus, commanded by a daemon in its world."""

from typing import Any

from hil.core.device import import_object
from hil.fakes.emulated_can import channel_of
from hil.fakes.emulated_device import EmulatedDevice, EmulationRequest
from hil.fakes.motor_controllers.daemon_in_world import commanded_on_can


def emulated(model: Any, request: EmulationRequest) -> EmulatedDevice:
    """The controller on a bus of its own.

    Args:
        model: a `hil.drivers.adhesion.daemon_fan.DaemonFan`.
        request: world and table of the bench file.
    """
    channel = channel_of(request)
    node = import_object(model.chip).build(request, channel)
    dbc = import_object(model.dbc) if model.dbc else ""
    return commanded_on_can(request, channel, [node], subnet=model.subnet, dbc=dbc, printed=model.printed)
