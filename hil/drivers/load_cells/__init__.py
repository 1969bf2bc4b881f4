"""Drivers of the cells that measure with which force the fan presses the robot on its surface."""

from hil.drivers.load_cells.can_cells import CanCells
from hil.drivers.load_cells.line_cells import LineCells

__all__ = ["CanCells", "LineCells"]
