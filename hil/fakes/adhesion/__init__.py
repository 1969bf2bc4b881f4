"""The emulated fan: its motor controller on CAN, its motor and battery."""

from hil.fakes.adhesion.motor import FAN_FAULTS, MotorNode
from hil.fakes.adhesion.options import AdhesionTruthOptions
from hil.fakes.adhesion.vesc import VescNode

__all__ = ["FAN_FAULTS", "AdhesionTruthOptions", "MotorNode", "VescNode"]
