"""What drivers of sensors that send unasked have in common: ports, packets, stamps, silence."""

from hil.drivers.links.can_sensor import CanSensor
from hil.drivers.links.packets import PacketParser
from hil.drivers.links.serial_port import PortLostError, SerialPort
from hil.drivers.links.serial_sensor import SerialSensor

__all__ = ["CanSensor", "PacketParser", "PortLostError", "SerialPort", "SerialSensor"]
