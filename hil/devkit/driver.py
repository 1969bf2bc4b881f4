"""What a driver of an added device uses."""

from hil.drivers.links.can_sensor import CanSensor
from hil.drivers.links.packets import LineParser, PacketParser
from hil.drivers.links.serial_port import PortLostError, SerialPort
from hil.drivers.links.serial_sensor import SerialSensor
from hil.drivers.links.streaming import StreamingSensor
from hil.drivers.patience import Usefulness, used_while_closed
from hil.drivers.stuck import StuckTest
from hil.vocabulary.clock import NS_PER_S, Clock, nanoseconds
from hil.vocabulary.errors import DeviceError, DeviceTimeoutError
from hil.vocabulary.interfaces import Holding, Sensor
from hil.vocabulary.signals import Stamp, Status

__all__ = [
    "NS_PER_S",
    "CanSensor",
    "Clock",
    "DeviceError",
    "DeviceTimeoutError",
    "Holding",
    "LineParser",
    "PacketParser",
    "PortLostError",
    "Sensor",
    "SerialPort",
    "SerialSensor",
    "Stamp",
    "Status",
    "StreamingSensor",
    "StuckTest",
    "Usefulness",
    "nanoseconds",
    "used_while_closed",
]
