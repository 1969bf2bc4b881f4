"""The emulated fan: its motor controller on CAN, its motor and battery."""

from hil.fakes.adhesion.options import AdhesionTruthOptions
from hil.fakes.adhesion.vesc import FAN_FAULTS, VescNode

__all__ = ["FAN_FAULTS", "AdhesionTruthOptions", "VescNode"]
