"""The 22 calibration bytes of a BNO055 (registers 0x55..0x6A) as a value, and as a file."""

from __future__ import annotations

import struct
from dataclasses import asdict, dataclass
from pathlib import Path

import tomli_w

from hil.core.errors import DataError, reason_of
from hil.support.atomic_files import write_text
from hil.support.file_reading import read_text, toml_tables

SIZE = 22
_MOST_BYTES = 1 << 16
_LAYOUT = struct.Struct("<11h")
_FORM = "22 bytes as 44 hex digits, or a TOML table with the eleven counts"

Counts = tuple[int, int, int]


@dataclass(frozen=True)
class ImuCalibration:
    """Offsets and radii in register counts: 0.01 m/s^2, 1/16 uT, 1/16 degree/s (datasheet 3.6.4)."""

    accelerometer_offset: Counts
    magnetometer_offset: Counts
    gyroscope_offset: Counts
    accelerometer_radius: int
    magnetometer_radius: int

    @staticmethod
    def from_bytes(data: bytes) -> ImuCalibration:
        """Decode the register block; raises `DataError` for another length."""
        if len(data) != SIZE:
            raise DataError("", f"IMU calibration has {len(data)} bytes", expected=_FORM)
        v = _LAYOUT.unpack(data)
        return ImuCalibration(v[0:3], v[3:6], v[6:9], v[9], v[10])

    def to_bytes(self) -> bytes:
        """The register block 0x55..0x6A."""
        return _LAYOUT.pack(
            *self.accelerometer_offset,
            *self.magnetometer_offset,
            *self.gyroscope_offset,
            self.accelerometer_radius,
            self.magnetometer_radius,
        )

    @staticmethod
    def load(path: str | Path) -> ImuCalibration:
        """Read a hex or TOML file; raises `DataError` naming it."""
        try:
            text = read_text(Path(path), _MOST_BYTES)
            if "=" not in text:
                return ImuCalibration.from_bytes(bytes.fromhex(text))
            calibration = ImuCalibration(**toml_tables(text, "as TOML"))
            return ImuCalibration.from_bytes(calibration.to_bytes())
        except DataError as error:
            raise DataError(str(path), error.message, expected=_FORM) from None
        except OSError as error:
            raise DataError(
                str(path),
                f"IMU calibration cannot be read ({reason_of(error)})",
                remedy="write one with `Bno055Imu.read_calibration().save(path)`",
            ) from None
        except (ValueError, TypeError, struct.error) as error:
            raise DataError(str(path), f"not an IMU calibration ({error})", expected=_FORM) from None

    def save(self, path: str | Path) -> None:
        """Write as TOML; raises `DataError` when that is impossible."""
        write_text(Path(path), tomli_w.dumps(asdict(self)))
