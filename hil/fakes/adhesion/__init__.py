"""The emulated fan: its motor controller on CAN, its motor and battery."""

from hil.fakes.adhesion.fan_parameters import AdhesionTruthOptions, FanTruthOptions, MotorTruthOptions
from hil.fakes.adhesion.motor_controller import FAN_FAULTS, MotorNode
from hil.fakes.adhesion.vesc_node import VescNode

__all__ = [
    "FAN_FAULTS",
    "AdhesionTruthOptions",
    "FanTruthOptions",
    "MotorNode",
    "MotorTruthOptions",
    "VescNode",
]
