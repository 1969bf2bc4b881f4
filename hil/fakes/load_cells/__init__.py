"""The emulated load cells under the fan, and the microcontroller that sends their counts."""

from hil.fakes.load_cells.cells_node import CellLine, CellNode
from hil.fakes.load_cells.hx711_cells import CELL_FAULTS, Cells, LoadCellTruthOptions

__all__ = ["CELL_FAULTS", "CellLine", "CellNode", "Cells", "LoadCellTruthOptions"]
