"""The table `[rangefinder]` of the bench file, for a TF-Luna."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from hil.config.device import MountedConfig, Position
from hil.config.values import Freshness, Patience, Within

LEAST_M, MOST_M = 0.2, 8.0
"""Blind zone, and range on a white target (Benewake TF-Luna manual, "Ranging Characteristics")."""
FIELD_OF_VIEW_RAD = 0.0349
"""2 degrees."""

_FASTEST_HZ, _MEASURED_HZ = 250, 500


class TfLunaConfig(MountedConfig):
    """How the range finder is reached, set up and judged.

    Attributes:
        port: any pyserial URL or device path.
        baud: of the link; what the sensor was set to (115200 as delivered).
        rate_hz: distances per second: 500 divided by a whole number, rounded down, at most 250.
        resolution: `cm` as delivered, or `mm`.
        save: whether the sensor is told to keep rate and resolution when its power goes. It keeps them in
            flash memory, which wears: once is enough.
        mount_position_m, mount_rotation_wxyz: the sensor in the body; its beam goes along its own x axis.
        latency_s: mean time from measurement to the host: the average over one period of output, the wire
            and the adapter.
        silence_s: after so long without a distance the settings are sent again: its power may have gone.
        stale_s: time without a usable distance after which the supervisor says so.
        stuck_after_s: identical readings for longer than this are marked frozen.
        fail_after_s: silence that raises instead of being reported as data.
        open_timeout_s: longest wait for a sensor that is still starting.
    """

    model: Literal["tf_luna"] = "tf_luna"
    port: str = Field("/dev/ttyUSB0", min_length=1)
    baud: int = Field(115_200, ge=9_600, le=921_600)
    rate_hz: int = Field(100, ge=1, le=_FASTEST_HZ)
    resolution: Literal["cm", "mm"] = "cm"
    save: bool = False
    mount_position_m: Position = (0.12, 0.0, 0.05)
    latency_s: float = Field(0.006, ge=0, le=1)
    silence_s: Annotated[float, Within(0.01, 10.0, "a sensor that has restarted must be found")] = 0.1
    stale_s: Patience = 0.5
    stuck_after_s: Freshness = 1.0
    fail_after_s: Patience = 3.0
    open_timeout_s: float = Field(1.0, gt=0, le=30)

    @field_validator("rate_hz")
    @classmethod
    def _whole(cls, value: int) -> int:
        if value != int(_MEASURED_HZ / round(_MEASURED_HZ / value)):
            raise ValueError(
                f"{value} Hz is not 500 divided by a whole number, for example 50, 100, 125 or 250"
            )
        return value
