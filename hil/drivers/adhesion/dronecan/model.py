"""A fan whose motor controller speaks DroneCAN (UAVCAN v0): a VESC in that mode, or another."""

from hil.config.dronecan import DroneCanConfig
from hil.drivers.adhesion.daemon_fan import DaemonFan


class DroneCan(DaemonFan):
    """A fan on a DroneCAN controller; discovery skips it, as a query makes the asker a node of the bus."""

    kind, name, title = "adhesion", "dronecan", "a ducted fan on a controller that speaks DroneCAN"
    config, subnet, printed = DroneCanConfig, 164, ("node_id", "esc_index")
    driver = "hil.drivers.adhesion.dronecan.driver:DroneCanFan"
    chip = "hil.fakes.adhesion.dronecan.chip:DroneCanNode"
