"""Connects emulated propellers: VESCs on one CAN bus, commanded by a daemon in their world."""

from typing import Any

from hil.fakes.emulated_can import channel_of
from hil.fakes.emulated_device import EmulatedDevice, EmulationRequest
from hil.fakes.motor_controllers.daemon_in_world import commanded_on_can
from hil.fakes.thrust.vesc.chip import VescThrustTruthOptions, propellers
from hil.links.vesc import DBC


def emulated(model: Any, request: EmulationRequest) -> EmulatedDevice:
    """The controllers on a bus of their own.

    Args:
        model: the `hil.drivers.thrust.vesc.model.VescPropellers`.
        request: world and table of the bench file.
    """
    channel = channel_of(request)
    options = request.options(VescThrustTruthOptions, timeout_s=request.config.timeout_s)
    nodes = propellers(request.world, channel, request.config, options)
    return commanded_on_can(request, channel, nodes, subnet=model.subnet, dbc=DBC, printed=model.printed)
