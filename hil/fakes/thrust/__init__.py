"""The emulated propellers: a Teensy that turns lines into pulses, controllers, motors."""

from hil.fakes.thrust.propeller_truth import ThrustTruthOptions
from hil.fakes.thrust.teensy_chip import THRUST_FAULTS, TeensyChip

__all__ = ["THRUST_FAULTS", "TeensyChip", "ThrustTruthOptions"]
