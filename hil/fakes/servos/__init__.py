"""The emulated servo bus: eight servos with firmware, timing and faults."""

from hil.fakes.servos.bus import ServoBus
from hil.fakes.servos.bus_truth import ServoBusOptions
from hil.fakes.servos.servo_faults import BUS_FAULTS, SERVO_FAULTS

__all__ = ["BUS_FAULTS", "SERVO_FAULTS", "ServoBus", "ServoBusOptions"]
