"""Two load cells on HX711 converters: their counts on CAN, or as lines."""

from __future__ import annotations

from hil.config.load_cells import CanCellsConfig, LineCellsConfig
from hil.devices.link_models import CanModel, SerialModel


class Hx711Can(CanModel):
    """Counts on CAN."""

    kind, name, title = "load_cells", "hx711_can", "two load cells on a CAN node"
    config, subnet = CanCellsConfig, 165
    driver, chip = "hil.drivers.load_cells:CanCells", "hil.fakes.load_cells:CellNode"


class Hx711Line(SerialModel):
    """Counts as lines."""

    kind, name, title = "load_cells", "hx711_line", "two load cells on a serial line"
    config = LineCellsConfig
    driver, chip = "hil.drivers.load_cells:LineCells", "hil.fakes.load_cells:CellLine"
