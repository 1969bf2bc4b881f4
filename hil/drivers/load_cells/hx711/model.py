"""The models `hx711_can` and `hx711_line` of the kind `load_cells`."""

from hil.config.load_cells import CanCellsConfig, LineCellsConfig
from hil.drivers.serial_and_can_models import CanModel, SerialModel


class Hx711Can(CanModel):
    """Load cells whose counts come as CAN frames."""

    kind, name, title = "load_cells", "hx711_can", "two load cells on a CAN node"
    config, subnet = CanCellsConfig, 165
    driver, chip = (
        "hil.drivers.load_cells.hx711.can_driver:CanCells",
        "hil.fakes.load_cells.hx711.chip:CellNode",
    )


class Hx711Line(SerialModel):
    """Load cells whose counts come as lines of text."""

    kind, name, title = "load_cells", "hx711_line", "two load cells on a serial line"
    config, wire, framing = LineCellsConfig, "lines", "line"
    driver, chip = (
        "hil.drivers.load_cells.hx711.line_driver:LineCells",
        "hil.fakes.load_cells.hx711.chip:CellLine",
    )
