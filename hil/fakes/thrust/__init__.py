"""The emulated propellers: a Teensy that converts lines to pulses, speed controllers, motors."""

from hil.fakes.thrust.propeller_truth import ThrustTruthOptions
from hil.fakes.thrust.teensy_chip import THRUST_FAULTS, TeensyChip

__all__ = ["THRUST_FAULTS", "TeensyChip", "ThrustTruthOptions"]
