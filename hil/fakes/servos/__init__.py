"""The emulated servo bus: eight servos with their firmware, timing and faults."""

from hil.fakes.servos.bus import ServoBus
from hil.fakes.servos.faulty import BUS_FAULTS, SERVO_FAULTS
from hil.fakes.servos.options import ServoBusOptions

__all__ = ["BUS_FAULTS", "SERVO_FAULTS", "ServoBus", "ServoBusOptions"]
