"""Configuration of the cells that measure the fan's force (`[load_cells]` of the bench file)."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from hil.config.assumed_parameters import Parameter, each, plus, times
from hil.config.can_bus import CanConfig, Claim
from hil.config.device import DeviceConfig
from hil.config.field_types import Baud, FrameOffset, Patience, Within

SHIPPED_DBC = Path(__file__).with_name("load_cells.dbc")
_SHIPPED_FRAME = 0x1B0

Newtons = Annotated[float, Within(-5000.0, 5000.0, "N of one cell")]
Pair = tuple[Newtons, Newtons]


class LoadCellsConfig(DeviceConfig):
    """Two cells on HX711 converters, however their counts arrive.

    Attributes:
        n_per_count: force of one count, by cell; negative where a cell is mounted the other way round.
        zero_n: force that each cell shows while the fan is off; `hil run adhesion_check` finds it.
        rate_hz: samples per second: 10 or 80, by the converter's RATE pin.
        largest_n: range of each cell; a cell at its end counts as broken.
        open_timeout_s: longest wait for the first sample.
        fail_after_s: uninterrupted silence that raises.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("n_per_count", (times(2.0), times(0.5), each(-1, 1)), ("adhesion",)),
        Parameter("zero_n", (plus(30.0), plus(-10.0, -10.0)), ("adhesion",)),
    )

    n_per_count: tuple[
        Annotated[float, Within(-0.01, 0.01, "N per count of 24 bits", smallest=1e-7)],
        Annotated[float, Within(-0.01, 0.01, "N per count of 24 bits", smallest=1e-7)],
    ] = (5e-5, 5e-5)
    zero_n: Pair = (0.0, 0.0)
    rate_hz: Annotated[float, Within(1.0, 320.0, "samples per second of an HX711")] = 80.0
    largest_n: Annotated[float, Within(1.0, 5000.0, "N of one cell; 40 kg are 392 N")] = 392.0
    open_timeout_s: Patience = 1.0
    fail_after_s: Patience = 1.0


class CanCellsConfig(LoadCellsConfig, CanConfig):
    """Cells whose microcontroller sends them on CAN.

    Attributes:
        dbc: path of a DBC file; the shipped `load_cells.dbc` when None.
        signals: DBC signals with the raw counts of both cells, in one message.
        node_id: added to the message's identifier.
    """

    PATHS: ClassVar[tuple[str, ...]] = ("dbc",)

    model: Literal["hx711_can"] = "hx711_can"
    dbc: str | None = None
    signals: tuple[str, str] = ("Cell1", "Cell2")
    node_id: FrameOffset = 0

    @property
    def dbc_path(self) -> Path:
        """The DBC file in use."""
        return SHIPPED_DBC if self.dbc is None else Path(self.dbc)

    def claims(self) -> Iterable[Claim]:
        """The frame of the shipped DBC; that of another is not known here."""
        if self.dbc is None:
            yield Claim("node_id", "frame", _SHIPPED_FRAME + self.node_id)


class LineCellsConfig(LoadCellsConfig):
    """Cells whose counts come as lines `LC <number> <counts> <counts>`: of the Teensy, or of another.

    Attributes:
        port: device path or any pyserial URL; may be that of `[thrust]`, which only writes.
        baud: baud rate of the line.
    """

    SHARES_PORT_WITH: ClassVar[tuple[str, ...]] = ("teensy",)

    model: Literal["hx711_line"] = "hx711_line"
    port: str = Field("/dev/ttyACM0", min_length=1)
    baud: Baud = 115_200
