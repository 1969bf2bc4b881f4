"""Fields of the MIP packets that a bench uses: descriptors, layouts, and one set of filter data.

Numbers and layouts as in the public MIP protocol (MIP SDK, MIT licence). Vectors are in the sensor's
"vehicle" frame, which the driver makes the sensor's own: x and y as printed on the case, z out of its
bottom. Attitude is with respect to north, east, down.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from hil.core.geometry import Four, Three
from hil.links.mip.packets import Packet

BASE, THREE_DM, FILTER = 0x01, 0x0C, 0x0D
SENSOR_DATA, FILTER_DATA, SYSTEM_DATA = 0x80, 0x82, 0xA0

PING, SET_IDLE, DEVICE_INFO, DESCRIPTORS, BUILT_IN_TEST, RESUME = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06
MORE_DESCRIPTORS, SOFT_RESET = 0x07, 0x7E
BASE_RATE, MESSAGE_FORMAT, STREAM, SETTINGS, TRANSFORM = 0x0E, 0x0F, 0x11, 0x30, 0x31
FILTER_RESET, AIDING = 0x01, 0x50
WRITE, READ, SAVE, LOAD, DEFAULT = 1, 2, 3, 4, 5

ACK = 0xF1
DEVICE_INFO_REPLY, DESCRIPTORS_REPLY, BUILT_IN_TEST_REPLY, MORE_DESCRIPTORS_REPLY = 0x81, 0x82, 0x83, 0x86
BASE_RATE_REPLY, MESSAGE_FORMAT_REPLY, STREAM_REPLY, TRANSFORM_REPLY = 0x8E, 0x8F, 0x85, 0xB1
DONE, UNKNOWN_COMMAND, INVALID_PARAMETER, COMMAND_FAILED = 0x00, 0x01, 0x03, 0x04
REFUSALS = {
    UNKNOWN_COMMAND: "unknown command",
    0x02: "invalid checksum",
    INVALID_PARAMETER: "invalid parameter",
    COMMAND_FAILED: "command failed",
    0x05: "the sensor timed out",
}

REFERENCE_TIME, STATUS, QUATERNION, ANGULAR_RATE, LINEAR_ACCELERATION, GRAVITY = (
    0xD5,
    0x10,
    0x03,
    0x0E,
    0x0D,
    0x13,
)
LAYOUTS = {
    REFERENCE_TIME: struct.Struct(">Q"),
    STATUS: struct.Struct(">3H"),
    QUATERNION: struct.Struct(">4fH"),
    ANGULAR_RATE: struct.Struct(">3fH"),
    LINEAR_ACCELERATION: struct.Struct(">3fH"),
    GRAVITY: struct.Struct(">3fH"),
}
"""Filter data that a bench uses, in the order of its message format."""
MEASURED = (QUATERNION, ANGULAR_RATE, LINEAR_ACCELERATION, GRAVITY)
FILTER_STATES = {0: "starting", 1: "initialising", 2: "vertical gyro", 3: "AHRS", 4: "full navigation"}
FIRST_RUNNING_STATE = 2
CONDITION_MASK, SOLUTION_ERROR = 0x0003, 0xF000
CONDITIONS = {1: "stable", 2: "converging", 3: "unstable"}
WARNINGS = {0x0004: "roll and pitch", 0x0008: "heading", 0x0040: "IMU bias", 0x0200: "mounting"}

MAGNETOMETER = 4
DYNAMICS_MODE = 1

MODELS = {"6286": "3DM-CV7-AHRS", "6287": "3DM-CV7-AR", "6288": "3DM-GV7-AHRS", "6289": "3DM-GV7-AR"}
"""Sensors by the first digits of their model number; all send the filter data above."""
WITHOUT_MAGNETOMETER = ("6287", "6289")

_INFO = struct.Struct(">H16s16s16s16s16s")
_FORMAT_ENTRY = struct.Struct(">BH")


@dataclass(frozen=True)
class DeviceInfo:
    """Identity of the sensor. `firmware` is a number such as 1007 for 1.0.07."""

    firmware: int
    model: str
    model_number: str
    serial: str
    lot: str
    options: str

    @staticmethod
    def from_bytes(data: bytes) -> DeviceInfo:
        """Decode the reply's data; raises `ValueError` for another length."""
        if len(data) != _INFO.size:
            raise ValueError(f"device info has {len(data)} bytes, not {_INFO.size}")
        firmware, *texts = _INFO.unpack(data)
        model, number, serial, lot, options = (text.decode("ascii", "replace").strip("\0 ") for text in texts)
        return DeviceInfo(firmware, model, number, serial, lot, options)

    def to_bytes(self) -> bytes:
        """The reply's data: texts of 16 characters, padded with spaces."""
        texts = (self.model, self.model_number, self.serial, self.lot, self.options)
        return _INFO.pack(self.firmware, *(text.encode("ascii").ljust(16)[:16] for text in texts))

    @property
    def firmware_text(self) -> str:
        """Firmware version as the vendor prints it, such as 1.0.07."""
        return f"{self.firmware // 1000}.{self.firmware // 100 % 10}.{self.firmware % 100:02d}"

    @property
    def number(self) -> str:
        """The part of the model number before the dash, which names the sensor type."""
        return self.model_number.partition("-")[0]


@dataclass(frozen=True)
class FilterData:
    """One set of filter data.

    Attributes:
        device_ns: the sensor's clock at the measurement, ns since it was switched on.
        state, flags: state and status flags of the filter.
        quaternion_wxyz: attitude (4,), sensor in north, east, down.
        rate_rad_s, linear_m_s2: rate and acceleration without gravity, (3,), sensor frame.
        gravity_m_s2: gravity (3,), sensor frame; points down.
        valid: True if the sensor marks each of these values as valid.
        raw: the bytes of all measured fields.
    """

    device_ns: int
    state: int
    flags: int
    quaternion_wxyz: Four
    rate_rad_s: Three
    linear_m_s2: Three
    gravity_m_s2: Three
    valid: bool
    raw: bytes

    @staticmethod
    def of(packet: Packet) -> FilterData | None:
        """Decode a packet; None when a field is missing or has another length than it should."""
        found = {f.descriptor: f.data for f in packet.fields}
        if any(len(found.get(key, b"")) != layout.size for key, layout in LAYOUTS.items()):
            return None
        w, x, y, z, attitude = LAYOUTS[QUATERNION].unpack(found[QUATERNION])
        *rate, rating = LAYOUTS[ANGULAR_RATE].unpack(found[ANGULAR_RATE])
        *linear, moving = LAYOUTS[LINEAR_ACCELERATION].unpack(found[LINEAR_ACCELERATION])
        *gravity, falling = LAYOUTS[GRAVITY].unpack(found[GRAVITY])
        state, _, flags = LAYOUTS[STATUS].unpack(found[STATUS])
        return FilterData(
            device_ns=LAYOUTS[REFERENCE_TIME].unpack(found[REFERENCE_TIME])[0],
            state=state,
            flags=flags,
            quaternion_wxyz=(w, x, y, z),
            rate_rad_s=(rate[0], rate[1], rate[2]),
            linear_m_s2=(linear[0], linear[1], linear[2]),
            gravity_m_s2=(gravity[0], gravity[1], gravity[2]),
            valid=bool(attitude & rating & moving & falling & 1),
            raw=b"".join(found[key] for key in MEASURED),
        )


def format_data(descriptor_set: int, entries: tuple[tuple[int, int], ...]) -> bytes:
    """Data of a message format from the set on: how many fields, and (descriptor, decimation) of each."""
    return bytes((descriptor_set, len(entries))) + b"".join(_FORMAT_ENTRY.pack(*entry) for entry in entries)


def format_entries(data: bytes) -> tuple[tuple[int, int], ...] | None:
    """(descriptor, decimation) pairs of a message format, from their count on; None when malformed."""
    if not data or len(data) != 1 + data[0] * _FORMAT_ENTRY.size:
        return None
    return tuple((entry[0], entry[1]) for entry in _FORMAT_ENTRY.iter_unpack(data[1:]))
