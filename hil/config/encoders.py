"""Configuration of the external steering encoders on CAN (`[encoders]` of the bench file)."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import model_validator

from hil.config.assumed_parameters import Parameter, each, order, plus
from hil.config.can_bus import CanConfig, Claim
from hil.config.field_types import Angle, FrameOffset, Patience, Signs, Switch, Within

SHIPPED_DBC = Path(__file__).with_name("as5045.dbc")
_SHIPPED_FRAMES = (0x1A0, 0x1A1, 0x1A2)

Names = tuple[str, str, str, str]


class EncodersConfig(CanConfig):
    """Address, decoding and limits of the AS5045 node.

    Attributes:
        dbc: path of a DBC file; the shipped `as5045.dbc` when None.
        signals: DBC signal with the raw word of each steering axis, wheel order FL BL BR FR.
        node_id: added to the frame identifiers of the DBC: the node's address switch.
        rate_hz: sample sets per second that the node sends.
        sign, zero_rad: encoder = sign * steering + zero, only used by the cross-check. Zeros that are left
            out are unknown; where they are given, an axis that is more than 0.15 rad off from the start on
            is reported, too.
        minus_servo_rad: encoder less the servo's own angle of each steering axis, signs applied and zeros
            not, as `hil run bring_up` has measured them together. An axis that is further off than
            `horn_slip_threshold_rad` is reported from the start on, and by `hil doctor`.
        yellow_mode: MagINC and MagDEC both set is then no fault (MagCompEn, datasheet).
        horn_slip_threshold_rad: lasting encoder minus servo difference that counts as horn slip.
        startup_discard: sample sets dropped after open and after a node reset.
        fail_after_s: uninterrupted silence that raises.
    """

    PATHS: ClassVar[tuple[str, ...]] = ("dbc",)
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("zero_rad", (plus(0.3), plus(0.2, 0.2, 0.2, 0.2)), ("servos",)),
        Parameter("sign", (each(1, -1, 1, 1), each(-1, -1, -1, -1)), ("servos",)),
        Parameter("signals", (order(3, 2, 1, 0), order(1, 0, 2, 3)), ("servos",)),
    )

    model: Literal["as5045"] = "as5045"
    dbc: str | None = None
    signals: Names = ("AngleFL", "AngleBL", "AngleBR", "AngleFR")
    node_id: FrameOffset = 0
    rate_hz: Annotated[float, Within(1.0, 1000.0, "sample sets per second")] = 200.0
    sign: Signs = (1, 1, 1, 1)
    zero_rad: tuple[Angle, Angle, Angle, Angle] | None = None
    minus_servo_rad: tuple[Angle, Angle, Angle, Angle] | None = None
    yellow_mode: Switch = False
    horn_slip_threshold_rad: Annotated[float, Within(0.001, 0.5, "a horn that slips further is off")] = 0.03
    startup_discard: Annotated[int, Within(0, 1000, "sample sets; 1000 are five seconds")] = 1
    fail_after_s: Patience = 1.0

    @property
    def zeros_rad(self) -> tuple[float, float, float, float]:
        """`zero_rad`, 0 where unknown."""
        return (0.0, 0.0, 0.0, 0.0) if self.zero_rad is None else self.zero_rad

    @property
    def dbc_path(self) -> Path:
        """The DBC file in use."""
        return SHIPPED_DBC if self.dbc is None else Path(self.dbc)

    def claims(self) -> Iterable[Claim]:
        """Both frames of the shipped DBC; those of another are not known here."""
        if self.dbc is None:
            yield from (Claim("node_id", "frame", frame_id + self.node_id) for frame_id in _SHIPPED_FRAMES)

    @model_validator(mode="after")
    def _check(self) -> EncodersConfig:
        if len(set(self.signals)) != 4:
            raise ValueError("signals must name four different signals")
        return self
