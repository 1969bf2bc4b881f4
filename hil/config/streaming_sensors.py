"""Tables of sensors that send unasked: on a serial port, or on a CAN bus."""

from typing import Annotated, ClassVar

from pydantic import Field

from hil.config.can_bus import CanConfig, Claim
from hil.config.device import DeviceConfig
from hil.config.field_types import Baud, Delay, Freshness, Patience, Within

Rate = Annotated[float, Within(0.1, 10_000.0, "samples per second")]


class StreamConfig(DeviceConfig):
    """Timing of a sensor's samples, and its timeouts.

    Attributes:
        rate_hz: samples per second.
        latency_s: mean time from measurement to the host.
        stale_s: time without a usable sample after which the supervisor reports it.
        stuck_after_s: identical samples for longer than this are marked frozen.
        fail_after_s: silence that raises instead of being reported as data.
        open_timeout_s: longest wait for an answer or a first sample.
    """

    rate_hz: Rate = 10.0
    latency_s: Delay = 0.0
    stale_s: Patience = 0.5
    stuck_after_s: Freshness = 1.0
    fail_after_s: Patience = 3.0
    open_timeout_s: Patience = 1.0


class SerialSensorConfig(StreamConfig):
    """A sensor at a serial port.

    Attributes:
        port: device path or any pyserial URL.
        baud: baud rate of the line.
    """

    port: str = Field("/dev/ttyUSB0", min_length=1)
    baud: Baud = 115_200


class CanSensorConfig(StreamConfig, CanConfig):
    """A sensor on a CAN bus."""

    FRAME_IDS: ClassVar[tuple[int, ...]] = ()
    """Identifiers of the frames of one sample, in the order in which they are sent."""

    def claims(self) -> tuple[Claim, ...]:
        """The frames of the sensor: no other device of the bus may send them."""
        return tuple(Claim("channel", "frame", frame_id) for frame_id in self.FRAME_IDS)
