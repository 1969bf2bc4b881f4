"""The public names for drivers of added devices."""

from hil.core.clock import NS_PER_S, Clock, nanoseconds
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.interfaces import Holding, Sensor
from hil.core.signals import Stamp, Status
from hil.links.packets import LineParser, PacketParser
from hil.links.serial_port import PortLostError, SerialPort
from hil.streams.can_sensor import CanSensor
from hil.streams.serial_sensor import SerialSensor
from hil.streams.silence_limit import SilenceTimer, used_while_closed
from hil.streams.streaming_sensor import StreamingSensor
from hil.streams.stuck_values import StuckTest

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
    "SilenceTimer",
    "Stamp",
    "Status",
    "StreamingSensor",
    "StuckTest",
    "nanoseconds",
    "used_while_closed",
]
