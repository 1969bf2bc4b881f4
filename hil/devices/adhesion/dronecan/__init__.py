"""A fan whose motor controller speaks DroneCAN (UAVCAN v0): a VESC in that mode, or another."""

from __future__ import annotations

from hil.devices.adhesion.dronecan.config import DroneCanConfig
from hil.devices.adhesion.vesc_model import DaemonFan

_HERE = "hil.devices.adhesion.dronecan"


class DroneCan(DaemonFan):
    """A fan on a DroneCAN controller; discovery skips it, as a query makes the asker a node of the bus."""

    kind, name, title = "adhesion", "dronecan", "a ducted fan on a controller that speaks DroneCAN"
    config, subnet, printed = DroneCanConfig, 164, ("node_id", "esc_index")
    driver, chip = f"{_HERE}.driver:DroneCanFan", f"{_HERE}.emulated_node:DroneCanNode"
