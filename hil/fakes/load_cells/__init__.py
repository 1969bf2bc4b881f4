"""The emulated load cells under the fan, and the microcontroller that sends their counts."""

from hil.fakes.load_cells.cells import CELL_FAULTS, Cells, LoadCellTruthOptions
from hil.fakes.load_cells.node import CellLine, CellNode

__all__ = ["CELL_FAULTS", "CellLine", "CellNode", "Cells", "LoadCellTruthOptions"]
