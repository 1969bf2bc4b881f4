"""Configuration of the BNO055 inertial unit on its UART (`[imu]` of the bench file)."""

from __future__ import annotations

from itertools import combinations
from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from hil.config.device import ImuConfig, Position
from hil.config.field_types import Baud, Delay, Freshness, Patience, Switch, Within

Byte = Annotated[int, Within(0, 255, "a register")]


class Bno055Config(ImuConfig):
    """Address, settings and limits of the IMU.

    Attributes:
        port: any pyserial URL or device path.
        baud: baud rate of the link; the BNO055 has 115200 only.
        fusion_mode: `imu` ignores the magnetometer (steel walls, motors); `ndof` uses it.
        external_crystal: true where a 32 kHz crystal is fitted (better clock and fusion).
        axis_map, axis_sign: registers 0x41 and 0x42; right-handed maps only (datasheet 3.4).
        mount_position_m, mount_rotation_wxyz: sensor (after the remap) in the body, m
            (arXiv 2509.04016).
        calibration_file: 22 offset bytes as hex text or as TOML, written at open and after a reset.
        prefetch: true to ask for the next burst at the end of each read, so that a read need not wait for the
            wire (3.5 ms); the sample is then one cycle old, and stamped so.
        reply_timeout_s: longest silence before a request counts as lost.
        retry_budget_s: time one `read` may spend on repeating requests.
        retry_gap_s: pause before a request is repeated after an error reply.
        open_timeout_s: longest wait for a chip that is still booting.
        check_period_s: interval at which mode and system status are read.
        fail_after_s: uninterrupted failure that raises instead of being reported as data.
        outage_poll_s: time between polls while the sensor is silent.
        stuck_after_s: time after which bit-identical data are marked frozen.
        sample_age_s: mean age of the fused data when read: half of the 10 ms fusion period.
    """

    PATHS: ClassVar[tuple[str, ...]] = ("calibration_file",)

    model: Literal["bno055"] = "bno055"
    port: str = Field("/dev/ttyUSB0", min_length=1)
    baud: Baud = 115_200
    fusion_mode: Literal["imu", "ndof", "ndof_fmc_off", "compass", "m4g"] = "imu"
    axis_map: Byte = 0x24
    axis_sign: Annotated[int, Within(0, 7, "a bit for each axis")] = 0x00
    external_crystal: Switch = False
    mount_position_m: Position = (0.0655, 0.0, 0.098)
    calibration_file: str | None = None
    prefetch: Switch = False
    reply_timeout_s: Annotated[float, Within(0.001, 1.0, "s; a reply takes 3.5 ms")] = 0.010
    retry_budget_s: Delay = 0.02
    retry_gap_s: Delay = 0.002
    open_timeout_s: Patience = 2.0
    check_period_s: Annotated[float, Within(0.01, 600.0, "a restarted chip must be found")] = 1.0
    fail_after_s: Patience = 3.0
    outage_poll_s: Annotated[float, Within(0.001, 10.0, "a sensor that is back must be seen soon")] = 0.05
    stuck_after_s: Freshness = 0.2
    sample_age_s: Delay = 0.005

    @field_validator("axis_map")
    @classmethod
    def _permutation(cls, value: int) -> int:
        if sorted((value >> shift) & 3 for shift in (0, 2, 4)) != [0, 1, 2] or value >> 6:
            raise ValueError(f"axis_map 0x{value:02X} is not a permutation of the axes, for example 0x24")
        return value

    @model_validator(mode="after")
    def _right_handed(self) -> Bno055Config:
        """An even permutation with an even number of signs, or both odd (datasheet 3.4: rotations only)."""
        axes = [(self.axis_map >> shift) & 3 for shift in (0, 2, 4)]
        swaps = sum(a > b for a, b in combinations(axes, 2))
        if (swaps + self.axis_sign.bit_count()) % 2:
            raise ValueError(
                f"axis_map 0x{self.axis_map:02X} with axis_sign 0x{self.axis_sign:02X} is a mirror image, "
                "which no placement gives: change one bit of axis_sign, for example 0x24 with 0x00"
            )
        return self
