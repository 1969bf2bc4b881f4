"""The registers that change by themselves: what a servo senses and shows, with the faults of its sensor."""

from __future__ import annotations

from hil.config.xh430 import TABLE
from hil.fakes.servos.faulty import ServoFaults
from hil.fakes.servos.sensing import Sensing
from hil.fakes.servos.servo import Servo
from hil.fakes.servos.thermal import Wear

_FIRST, _END = TABLE["realtime_tick"].address, TABLE["backup_ready"].address
_INDIRECT = TABLE["indirect_data_1"].address
_CYCLIC_FIRST = TABLE["present_current"].address
_CYCLIC_END = TABLE["present_position"].address + 4


class LiveRegisters:
    """Brings a servo's measurements up to date when somebody looks.

    Args:
        sensing: encoders, velocities and currents of all servos.
        wear: voltage and temperatures.
        faults: of the sensors.
    """

    def __init__(self, sensing: Sensing, wear: Wear, faults: ServoFaults) -> None:
        self._sensing, self._wear, self._faults = sensing, wear, faults
        self._stamp = (-1, -1)
        self._holding = False
        self._all: tuple[list[int], list[int], list[int]] = ([], [], [])

    def hold(self) -> None:
        """Measure now; from the first call on, this is what the servos know until the next."""
        self._holding = True
        self._measure()

    def sense(self, servo: Servo, t_ns: int) -> tuple[int, int]:
        """Let a servo sense; its velocity and current counts in the joint's direction."""
        sensing, faults, j = self._sensing, self._faults, servo.joint
        stamp = (t_ns, sensing.ticks)
        if self._stamp != stamp and not self._holding:
            self._stamp = stamp
            self._measure()
        all_counts, all_velocities, all_currents = self._all
        counts, velocity, current = all_counts[j], all_velocities[j], all_currents[j]
        if not faults.none:
            age_ns = faults.age_ns(j, t_ns)
            if age_ns:
                counts, velocity = sensing.counts(age_ns)[j], sensing.velocity(age_ns)[j]
            counts, velocity, current = faults.measured(j, t_ns, (counts, velocity, current))
        servo.sense(counts, velocity)
        return velocity, current

    def refresh(self, servo: Servo, address: int, length: int, t_ns: int) -> None:
        """Put what a read of this range may see into the servo's table."""
        end = address + length
        if end <= _FIRST or (address >= _END and end <= _INDIRECT):
            return
        velocity, current = self.sense(servo, t_ns)
        if address >= _CYCLIC_FIRST and end <= _CYCLIC_END:
            servo.show_motion(velocity, current)
            return
        wear, j = self._wear, servo.joint
        duty = float(self._sensing.duty(wear.volts)[j])
        servo.show(t_ns, velocity, current, duty, int(wear.volts * 10), int(wear.celsius[j]))

    def _measure(self) -> None:
        sensing = self._sensing
        self._all = (sensing.counts(), sensing.velocity(), sensing.current())
