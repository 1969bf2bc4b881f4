"""Live registers: measurements of a servo with the faults of its sensors.

Some servos update their registers at a fixed period. The public recordings have one joint state every
16.0 ms: half of the periods within 0.04 ms, a standard deviation of 0.5 ms, one period in five hundred above
20 ms, the longest 29 ms.
"""

from collections.abc import Callable

import numpy as np

from hil.core.clock import nanoseconds
from hil.core.signals import SERVOS
from hil.fakes.servos.dynamixel.faults import ServoFaults
from hil.fakes.servos.dynamixel.sensing import GRID_NS, Sensing
from hil.fakes.servos.dynamixel.servo import Servo
from hil.fakes.servos.dynamixel.thermal_load import ThermalModel
from hil.fakes.servos.dynamixel.true_parameters import ServoBusOptions
from hil.fakes.world import Scheduled

_RARE = 0.05
_RARE_FACTOR = 8.0
_SHORTEST_GAP_S = 0.004


class LiveRegisters:
    """Updates a servo's measurements when they are read.

    Args:
        sensing: encoders, velocities and currents of all servos.
        thermal: supply voltage and temperatures.
        faults: faults of the sensors.
    """

    def __init__(self, sensing: Sensing, thermal: ThermalModel, faults: ServoFaults) -> None:
        self._sensing, self._thermal, self._faults = sensing, thermal, faults
        self._stamp = (-1, -1)
        self._holding = False
        self._all: list[list[int]] = []
        self._duty_stamp, self._duty = (-1, -1.0), [0.0] * len(SERVOS)

    def hold(self) -> None:
        """Measure all servos now; from the first call on, measurements are updated here only."""
        self._holding = True
        self._measure()

    def sense(self, servo: Servo, t_ns: int) -> tuple[int, int]:
        """Update a servo's measurements; returns its velocity and current counts in the joint's direction."""
        sensing, faults, j = self._sensing, self._faults, servo.joint
        self._renew(t_ns)
        all_counts, all_velocities, all_currents = self._all
        counts, velocity, current = all_counts[j], all_velocities[j], all_currents[j]
        if not faults.none:
            age_ns = faults.age_ns(j, t_ns)
            if age_ns:
                counts = sensing.counts(max(age_ns - t_ns % GRID_NS, 1))[j]
                velocity = sensing.velocity(age_ns)[j]
            counts, velocity, current = faults.measured(j, t_ns, (counts, velocity, current))
        servo.sense(counts, velocity)
        return velocity, current

    def motion(self, servos: list[Servo], address: int, length: int, t_ns: int) -> list[bytes] | None:
        """Update and return the same registers of several servos, where all are read in every cycle.

        None for other registers, and for sensors with faults.
        """
        row = servos[0].table.layout.motion
        begin, end = address - row.address, address + length - row.address
        if begin < 0 or address + length > row.end or length == 0 or not self._faults.none:
            return None
        if any(servo.table.layout.motion is not row for servo in servos):
            return None
        self._renew(t_ns)
        counts, velocities, currents = self._all
        found = []
        for servo in servos:
            j = servo.joint
            data = row.pack(*servo.motion(counts[j], velocities[j], currents[j]))
            servo.table.put_row(row, data)
            found.append(data[begin:end])
        return found

    def refresh(self, servo: Servo, address: int, length: int, t_ns: int) -> None:
        """Update the registers that a read of this range may cover."""
        end, layout = address + length, servo.table.layout
        measured, motion = layout.measured, layout.motion
        if end <= measured.address or (address >= measured.end and end <= layout.first_indirect):
            return
        velocity, current = self.sense(servo, t_ns)
        if address >= motion.address and end <= motion.end:
            values = servo.motion(servo.axis.position.encoder, velocity, current)
            servo.table.put_row(motion, motion.pack(*values))
            return
        thermal, j = self._thermal, servo.joint
        servo.show(
            t_ns, velocity, current, self._duties(t_ns)[j], int(thermal.volts * 10), int(thermal.celsius[j])
        )

    def _duties(self, t_ns: int) -> list[float]:
        """Present duty cycles (8,) of the motors."""
        stamp = (t_ns, self._thermal.volts)
        if self._duty_stamp != stamp:
            self._duty_stamp, self._duty = stamp, self._sensing.duty(self._thermal.volts).tolist()
        return self._duty

    def _renew(self, t_ns: int) -> None:
        """Measure all servos, unless they have been measured at this time."""
        stamp = (t_ns, self._sensing.ticks)
        if self._stamp != stamp and not self._holding:
            self._stamp = stamp
            self._measure()

    def _measure(self) -> None:
        self._all = self._sensing.measure().tolist()


class Cadence(Scheduled):
    """Calls `renew` at the recorded period.

    Args:
        options: `cadence_s` and related options.
        rng: random stream of the bus.
        renew: function that makes one measurement.
    """

    alone = True
    announces = True

    def __init__(self, options: ServoBusOptions, rng: np.random.Generator, renew: Callable[[], None]) -> None:
        self._options, self._rng, self._renew = options, rng, renew
        self._period_ns = nanoseconds(options.cadence_s)
        self._slot = 0
        self._due_ns = 0

    def next_due_ns(self) -> int:
        """Time of the next measurement."""
        return self._due_ns

    def on_due(self, t_ns: int) -> None:
        """Measure, and schedule the next measurement near its grid point."""
        self._renew()
        self._slot += 1
        self._due_ns = max(t_ns + 1, self._slot * self._period_ns + nanoseconds(self._late_s()))

    def _late_s(self) -> float:
        options, rng = self._options, self._rng
        kind = float(rng.random())
        late_s = options.cadence_jitter_s * float(rng.standard_normal())
        if kind < options.cadence_gaps_per_s * options.cadence_s:
            most_s = max(options.cadence_longest_gap_s - options.cadence_s, _SHORTEST_GAP_S)
            return float(rng.uniform(_SHORTEST_GAP_S, most_s))
        return late_s * _RARE_FACTOR if kind > 1.0 - _RARE else late_s
