"""What an emulated chip of an added device uses."""

from hil.devices.emulated import EmulatedDevice, Face, Wired, on_serial_line
from hil.fakes.can_node import CanStreamingNode
from hil.fakes.can_wire import CanChannel
from hil.fakes.fault import PERIODIC, Fault, Supported
from hil.fakes.faults import DeviceFaults
from hil.fakes.request import EmulationRequest
from hil.fakes.streaming import COMMON_FAULTS, SerialStreamingChip, StreamingChip
from hil.fakes.wire import Reply, SerialChip
from hil.fakes.world import NEVER_NS, Scheduled, World
from hil.vocabulary.clock import NS_PER_S, nanoseconds
from hil.vocabulary.device import Connection
from hil.vocabulary.geometry import rotated

__all__ = [
    "COMMON_FAULTS",
    "NEVER_NS",
    "NS_PER_S",
    "PERIODIC",
    "CanChannel",
    "CanStreamingNode",
    "Connection",
    "DeviceFaults",
    "EmulatedDevice",
    "EmulationRequest",
    "Face",
    "Fault",
    "Reply",
    "Scheduled",
    "SerialChip",
    "SerialStreamingChip",
    "StreamingChip",
    "Supported",
    "Wired",
    "World",
    "nanoseconds",
    "on_serial_line",
    "rotated",
]
