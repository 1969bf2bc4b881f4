"""Register map of the BNO055: addresses, reset values, access rights, operating modes.

Source: Bosch BNO055 datasheet rev 1.4.
"""

from dataclasses import dataclass

PAGE_ID, DATA = 0x07, 0x08
SELFTEST, INT_STA, SYS_STATUS = 0x36, 0x37, 0x39
UNIT_SEL, OPR_MODE, PWR_MODE, SYS_TRIGGER = 0x3B, 0x3D, 0x3E, 0x3F
TEMP_SOURCE, AXIS_MAP, AXIS_SIGN, SIC = 0x40, 0x41, 0x42, 0x43
ACC_OFFSET, MAG_OFFSET, GYR_OFFSET, ACC_RADIUS, LAST = 0x55, 0x5B, 0x61, 0x67, 0x6A
INT_MSK, INT_EN, UNIQUE_ID = 0x0F, 0x10, 0x50
SIZE = 0x80

TRIGGER_SELF_TEST, TRIGGER_RESET_INT, TRIGGER_RESET, TRIGGER_CRYSTAL = 0x01, 0x40, 0x20, 0x80

UNIT_MG, UNIT_RAD_S, UNIT_EULER_RAD, UNIT_FAHRENHEIT, UNIT_ANDROID = 0x01, 0x02, 0x04, 0x10, 0x80

POWER_SUSPEND = 2

STATUS_IDLE, STATUS_FUSION, STATUS_NO_FUSION = 0, 5, 6


@dataclass(frozen=True)
class Mode:
    """Sensors that are on in an operating mode, and its output rate.

    A fusion gives the heading relative to that at its start or, if `absolute`, to magnetic north
    (datasheet 3.3.3).
    """

    accelerometer: bool
    magnetometer: bool
    gyroscope: bool
    fusion: bool
    rate_hz: float = 100.0
    absolute: bool = False


MODES = {
    0x0: Mode(False, False, False, False),
    0x1: Mode(True, False, False, False),
    0x2: Mode(False, True, False, False),
    0x3: Mode(False, False, True, False),
    0x4: Mode(True, True, False, False),
    0x5: Mode(True, False, True, False),
    0x6: Mode(False, True, True, False),
    0x7: Mode(True, True, True, False),
    0x8: Mode(True, False, True, True),
    0x9: Mode(True, True, False, True, 20.0, absolute=True),
    0xA: Mode(True, True, False, True, 50.0),
    0xB: Mode(True, True, True, True, absolute=True),
    0xC: Mode(True, True, True, True, absolute=True),
}
CONFIG = 0x0


def page_zero() -> bytearray:
    """Page 0 after a reset."""
    page = bytearray(SIZE)
    page[0:7] = bytes((0xA0, 0xFB, 0x32, 0x0F, 0x11, 0x03, 0x15))
    page[SELFTEST] = 0x0F
    page[UNIT_SEL] = UNIT_ANDROID
    page[TEMP_SOURCE] = 0x02
    page[AXIS_MAP] = 0x24
    for diagonal in (0, 4, 8):
        page[SIC + 2 * diagonal + 1] = 0x40
    page[ACC_RADIUS : ACC_RADIUS + 4] = bytes((0xE8, 0x03, 0xE0, 0x01))
    return page


def page_one(serial: int) -> bytearray:
    """Page 1 after a reset; `serial` fills the 16-byte unique identifier."""
    page = bytearray(SIZE)
    page[0x08:0x0E] = bytes((0x0D, 0x6D, 0x38, 0x00, 0x00, 0x00))
    page[0x11:0x20] = bytes(
        (0x14, 0x03, 0x0F, 0xC0, 0x0A, 0x0B, 0x00, 0x00, 0x00, 0x04, 0x19, 0x01, 0x19, 0x01, 0x19)
    )
    page[UNIQUE_ID : UNIQUE_ID + 16] = serial.to_bytes(16, "little")
    return page


def writable(page: int, address: int) -> bool:
    """Whether a client may write the register in any mode."""
    if address == PAGE_ID:
        return True
    if page == 0:
        return address in (UNIT_SEL, OPR_MODE, PWR_MODE, SYS_TRIGGER) or TEMP_SOURCE <= address <= LAST
    return 0x08 <= address <= 0x0D or INT_MSK <= address <= 0x1F


def writable_while_running(page: int, address: int) -> bool:
    """Whether the register may be written outside CONFIG mode."""
    if address == PAGE_ID:
        return True
    if page == 0:
        return address in (OPR_MODE, SYS_TRIGGER)
    return address in (INT_MSK, INT_EN)
