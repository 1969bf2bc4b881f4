"""Parts of which a device is made: descriptions; drivers in `hil.devkit.driver`, chips in `hil.devkit.chip`.

Every command imports the description, so it names driver and chip by string and imports neither.
"""

from typing import TYPE_CHECKING

from hil.config.can_bus import CanConfig
from hil.config.device import DeviceConfig, MountedConfig, Position
from hil.config.field_types import Baud, Delay, Freshness, Patience, Within
from hil.config.streaming_sensors import CanSensorConfig, SerialSensorConfig, StreamConfig
from hil.core.device import Connection, DeviceKind, DeviceModel, Figures, Force, Found, Plot, Search, Topic
from hil.core.finding import Finding, Level
from hil.core.geometry import Array
from hil.core.signals import Inputs, Stamp, Status
from hil.drivers.doctor_watch import Watched, losses
from hil.drivers.serial_and_can_models import CanModel, SerialModel
from hil.loop.cycle_data import Check, Cycle, LastingCheck

if TYPE_CHECKING:
    from hil.recording.rosbags_adapter import MessageMaker as MessageMaker  # importing it loads rosbags

__all__ = [
    "Array",
    "Baud",
    "CanConfig",
    "CanModel",
    "CanSensorConfig",
    "Check",
    "Connection",
    "Cycle",
    "Delay",
    "DeviceConfig",
    "DeviceKind",
    "DeviceModel",
    "Figures",
    "Finding",
    "Force",
    "Found",
    "Freshness",
    "Inputs",
    "LastingCheck",
    "Level",
    "MountedConfig",
    "Patience",
    "Plot",
    "Position",
    "Search",
    "SerialModel",
    "SerialSensorConfig",
    "Stamp",
    "Status",
    "StreamConfig",
    "Topic",
    "Watched",
    "Within",
    "losses",
]
