"""Configuration of a MicroStrain sensor on its serial port (`[imu]` with `model = "microstrain"`)."""

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from hil.config.device import ImuConfig, Position
from hil.config.field_types import Baud, Freshness, Patience, Switch, UnitQuaternion, Within

BITS_PER_BYTE = 10
"""Bits of a byte on a serial line: start, eight of data, stop."""
PACKET_BYTES = 92
"""Length of the packet that holds all measurements of a bench (`hil.links.mip.fields.LAYOUTS`)."""
_FULLEST = 0.95
_PROCESSING_S = 0.002


class MicrostrainConfig(ImuConfig):
    """Address, settings and limits of the sensor.

    Attributes:
        port: any pyserial URL or device path.
        baud: baud rate of the link, as the sensor is set: 115200 when delivered, up to 921600. The sensor's
            own USB port takes any; write 921600 there.
        rate_hz: samples per second, nearly: the sensor divides its own rate (1000 Hz) by a whole number. The
            default gives 111 Hz, which does not keep step with a 100 Hz loop: some samples are always read
            fresh, and show how old the others are. At 100 Hz stamps may be late by up to a cycle.
        magnetometer: true if it may correct the heading; not beside steel walls and motors.
        mount_position_m, mount_rotation_wxyz: sensor in the body, m; z comes out of the sensor's bottom, so
            that one that lies flat with its label up is turned by half a turn about x.
        latency_s: smallest time from measurement to arrival, which no host clock can see; when not given,
            2 ms for the sensor and the time that a packet takes at `baud`.
        reply_timeout_s: longest wait for the answer to a command before it is sent again.
        open_timeout_s: longest wait for a sensor that is still starting.
        fail_after_s: uninterrupted failure that raises instead of being reported as data.
        stuck_after_s: time after which bit-identical data are marked frozen.
        stale_after_s: age after which samples are marked stale.
    """

    model: Literal["microstrain"] = "microstrain"
    port: str = Field("/dev/ttyUSB0", min_length=1)
    baud: Baud = 115_200
    rate_hz: Annotated[float, Within(10.0, 1000.0, "the sensor has 1000 Hz")] = Field(
        110.0, validate_default=True
    )
    magnetometer: Switch = False
    mount_position_m: Position = (0.0655, 0.0, 0.098)
    mount_rotation_wxyz: UnitQuaternion = (0.0, 1.0, 0.0, 0.0)
    latency_s: Annotated[float, Within(0.0, 0.1, "a sensor that is later is of no use")] | None = None
    reply_timeout_s: Annotated[float, Within(0.001, 1.0, "s; an answer takes 20 ms")] = 0.1
    open_timeout_s: Patience = 5.0
    fail_after_s: Patience = 5.0
    stuck_after_s: Freshness = 0.2
    stale_after_s: Freshness = 0.1

    @field_validator("rate_hz")
    @classmethod
    def _fits(cls, value: float, info: ValidationInfo) -> float:
        baud = info.data.get("baud")
        needed = value * PACKET_BYTES * BITS_PER_BYTE
        if baud is not None and needed > _FULLEST * baud:
            most_hz = _FULLEST * baud / (PACKET_BYTES * BITS_PER_BYTE)
            raise ValueError(
                f"needs {needed:.0f} bits per second and baud has {baud}: at most {most_hz:.0f} Hz, "
                "or set sensor and bench to 921600 baud"
            )
        return value

    @property
    def delay_s(self) -> float:
        """Smallest time from measurement to arrival, given or from the line's speed."""
        if self.latency_s is not None:
            return self.latency_s
        return _PROCESSING_S + PACKET_BYTES * BITS_PER_BYTE / self.baud
