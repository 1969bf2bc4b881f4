"""The fault campaign: tests every fault of every emulated device at several moments of a short climb.

A cell is one device, one fault, one moment, one seed and one physics model. Its verdict states whether the
robot was held within the bounds of the fault class, whether the faulty device was named as suspect, whether
the robot recovered where it should, and whether the recording can be read.
"""

from hil.fault_matrix.cases import (
    MOMENTS,
    PLANTS,
    Cell,
    cells_of,
    is_tested_itself,
    quick_cells,
    random_cells,
)
from hil.fault_matrix.drive import run_cell
from hil.fault_matrix.judge import CellVerdict, lost
from hil.fault_matrix.matrix_table import matrix_page, write_faults, write_page
from hil.fault_matrix.summary import summary, told_rows
from hil.fault_matrix.verdict_log import KeptVerdicts, missing

__all__ = [
    "MOMENTS",
    "PLANTS",
    "Cell",
    "CellVerdict",
    "KeptVerdicts",
    "cells_of",
    "is_tested_itself",
    "lost",
    "matrix_page",
    "missing",
    "quick_cells",
    "random_cells",
    "run_cell",
    "summary",
    "told_rows",
    "write_faults",
    "write_page",
]
