"""The public names for emulated chips of added devices."""

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.device import Connection
from hil.core.geometry import rotated
from hil.fakes.can_channel import CanChannel
from hil.fakes.emulated_device import EmulatedDevice, Transport, Wired, on_serial_line
from hil.fakes.emulation_request import EmulationRequest
from hil.fakes.serial_chip import Reply, SerialChip
from hil.fakes.streaming_chip import COMMON_FAULTS, CanStreamingNode, SerialStreamingChip, StreamingChip
from hil.fakes.world import NEVER_NS, Scheduled, World
from hil.faults.fault import PERIODIC, Fault, Supported
from hil.faults.plan import DeviceFaults

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
    "Fault",
    "Reply",
    "Scheduled",
    "SerialChip",
    "SerialStreamingChip",
    "StreamingChip",
    "Supported",
    "Transport",
    "Wired",
    "World",
    "nanoseconds",
    "on_serial_line",
    "rotated",
]
