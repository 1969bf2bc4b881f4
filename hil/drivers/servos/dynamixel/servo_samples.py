"""Converts reads of the bus to samples: multi-turn positions, restarts, hardware errors, health.

A register in velocity mode counts turns until the servo restarts; then it shows one turn again. A change that
no motor could have made since the last reading is such a restart, and positions go on counting.
"""

import logging
import struct
from collections.abc import Sequence
from operator import add, sub

import numpy as np

from hil.config.servo_models import ServoModel
from hil.config.servo_models.x_series_codes import hardware_error_text
from hil.config.servos import ServosConfig
from hil.core.clock import Clock, nanoseconds
from hil.core.geometry import Array
from hil.core.signals import SERVOS, ServoHealth, ServoSample, Stamp, Status
from hil.drivers.servos.dynamixel.cyclic_read import ALL_OK, Reading
from hil.drivers.servos.dynamixel.recovery import RamRecovery
from hil.drivers.servos.dynamixel.register_map import RegisterMap

_MARGIN_COUNTS = 512
_WORD = 1 << 32
_COASTING_S = 0.1
_ZERO = (0,) * len(SERVOS)

Counts = np.ndarray

ALL_SERVOS, NO_SERVOS = np.ones(len(SERVOS), dtype=bool), np.zeros(len(SERVOS), dtype=bool)
for _mask in (ALL_SERVOS, NO_SERVOS):
    _mask.setflags(write=False)


_LOG = logging.getLogger(__name__)
_NO_ALERT: tuple[int, ...] = (0,) * len(SERVOS)
_floats, _DOUBLES = np.frombuffer, struct.Struct("24d").pack
_LOOKS = 4
"""Full reads in the period of a health sample: a watchdog that trips unnoticed stops its wheel, and
the supervisor reports a blocked wheel after half a second."""


class MultiTurnCounter:
    """Adds the turns that the registers of eight servos have lost.

    Args:
        model: model of the servos: gives counts per turn and highest speed.

    Attributes:
        offset: (8,) counts to add to a register.
    """

    def __init__(self, model: ServoModel) -> None:
        self._turn_counts = model.counts_per_turn
        self._top_counts_s = model.top_speed_rad_s / model.rad_per_count
        self.offset: Sequence[int] = _ZERO
        self._last: Sequence[int] = _ZERO
        self._velocity: Sequence[int] = _ZERO
        self._last_ns = np.zeros(len(SERVOS), dtype=np.int64)
        self._speed_counts = model.rad_s_per_count / model.rad_per_count
        self._known = np.zeros(len(SERVOS), dtype=bool)
        self._restarted = np.zeros(len(SERVOS), dtype=bool)
        self._together_ns: int | None = None

    def restarted(self, joint: int) -> None:
        """Note that a servo has restarted: its next reading is bridged to the nearest turn."""
        self._restarted[joint] = True
        self._part()

    def follow(
        self, raw: Sequence[int], velocity: Sequence[int], seen: np.ndarray, t_ns: int
    ) -> tuple[Sequence[int], np.ndarray]:
        """Continuous counts, and which servos have restarted.

        Args:
            raw: (8,) registers.
            velocity: (8,) registers, to bridge a gap.
            seen: (8,) whether the servo answered; `ALL_SERVOS` itself where all did.
            t_ns: time of the reading.
        """
        counts = raw if self.offset is _ZERO else list(map(add, raw, self.offset))
        if seen is ALL_SERVOS and self._together_ns is not None:
            moved = list(map(sub, counts, self._last))
            most = self._top_counts_s * ((t_ns - self._together_ns) * 1e-9) + _MARGIN_COUNTS
            if max(moved) <= most and -min(moved) <= most:
                self._last, self._velocity, self._together_ns = counts, velocity, t_ns
                return counts, NO_SERVOS
        self._part()
        counts, jumped = self._look_at_each(np.array(counts), np.array(velocity), seen, t_ns)
        self._together_ns = t_ns if seen is ALL_SERVOS else None
        return counts, jumped

    def _part(self) -> None:
        """Keep the time of the last reading for each servo from now on."""
        if self._together_ns is not None:
            self._last_ns[:] = self._together_ns
            self._together_ns = None

    def _look_at_each(
        self, counts: Counts, velocity: Counts, seen: np.ndarray, t_ns: int
    ) -> tuple[list[int], np.ndarray]:
        elapsed_s = (t_ns - self._last_ns) * 1e-9
        change = counts - self._last
        impossible = np.abs(change) > self._top_counts_s * elapsed_s + _MARGIN_COUNTS
        jumped = seen & self._known & (impossible | self._restarted)
        if jumped.any():
            counts = self._bridge(counts, change, jumped, elapsed_s)
        self._restarted &= ~seen
        self._last = np.where(seen, counts, self._last).tolist()
        self._last_ns = np.where(seen, t_ns, self._last_ns)
        self._velocity = np.where(seen, velocity, self._velocity).tolist()
        self._known |= seen
        return counts.tolist(), jumped

    def _bridge(self, counts: Counts, change: Counts, jumped: np.ndarray, elapsed_s: np.ndarray) -> Counts:
        coasted = np.array(self._velocity) * self._speed_counts * np.minimum(elapsed_s, _COASTING_S)
        excess = change - coasted
        words = np.rint(excess / _WORD).astype(np.int64) * _WORD
        turns = np.rint((excess - words) / self._turn_counts).astype(np.int64) * self._turn_counts
        lost = np.where(jumped, words + turns, 0)
        self.offset = (np.array(self.offset) - lost).tolist()
        bridged: Counts = counts - lost
        return bridged


class Samples:
    """Converts readings to samples; keeps turns, alerts and the sequence number between them.

    Args:
        registers: register map of the servos' model.
        blocks: their registers as read at open.
        upkeep: recovery that reads and stores hardware errors.
        clock: clock for the time at which a sample had arrived.
        device: name in logs.

    Attributes:
        turns: positions across restarts.
        doubtful: True if a full read should follow the latest sample: a servo has restarted, or is back.
    """

    def __init__(
        self, registers: RegisterMap, blocks: Sequence[bytes], upkeep: RamRecovery, clock: Clock, device: str
    ) -> None:
        self._upkeep, self._clock, self._device = upkeep, clock, device
        model, read = registers.model, registers.from_block
        self._scales = np.repeat((model.rad_per_count, model.rad_s_per_count, model.a_per_count), 8)
        self._zeros = (model.zero_counts,) * len(SERVOS)
        self.turns, self.doubtful = MultiTurnCounter(model), False
        self._registers: Sequence[int] = [read(b, "present_position") for b in blocks]
        self._alert = [0] * len(SERVOS)
        self._sequence = 0

    def registers(self, reading: Reading | None = None) -> np.ndarray:
        """(8,) position registers as last known, with those of a reading that is not yet sampled."""
        return np.array(self._registers if reading is None else self._known(reading), dtype=np.int64)

    def _known(self, reading: Reading) -> Sequence[int]:
        """Position registers (8,) of a reading; of servos that have not answered, as last known."""
        now = reading.registers["position"]
        if reading.status is ALL_OK:
            return now
        seen = _seen(reading).tolist()
        return [new if there else old for new, there, old in zip(now, seen, self._registers, strict=True)]

    def sample(self, reading: Reading, restarted: tuple[int, ...]) -> ServoSample:
        """The sample of a reading.

        Args:
            reading: reading of the bus.
            restarted: joints that were found to have restarted, and have been set up again.
        """
        self._sequence += 1
        stamp = Stamp(reading.taken_ns, self._clock.now_ns(), self._sequence)
        counts, jumped = self._follow(reading)
        values = self._in_si(counts, reading)
        position, velocity, current = values[0:8], values[8:16], values[16:24]
        status, alert = reading.status, _NO_ALERT
        self.doubtful = bool(reading.revived)
        if status is not ALL_OK or restarted or jumped is not NO_SERVOS or any(self._alert):
            status, alert = self._judge(reading, restarted, jumped)
            bad = np.array([s is not Status.OK for s in status])
            position[bad] = velocity[bad] = current[bad] = np.nan
        return ServoSample(stamp, position, velocity, current, status, alert)

    def position(self, reading: Reading) -> Array:
        """(8,) rad of a reading that becomes no sample; NaN where a servo did not answer."""
        counts, _ = self._follow(reading)
        position = self._in_si(counts, reading)[0:8]
        position[~_seen(reading)] = np.nan
        return position

    def _in_si(self, counts: Sequence[int], reading: Reading) -> Array:
        """(24,) positions in rad, velocities in rad/s, currents in A."""
        rows = reading.registers
        from_zero = map(sub, counts, self._zeros)
        values: Array = _floats(_DOUBLES(*from_zero, *rows["velocity"], *rows["current"])) * self._scales
        return values

    def _follow(self, reading: Reading) -> tuple[Sequence[int], np.ndarray]:
        """Continuous positions (8,) in counts, and which servos have restarted."""
        rows = reading.registers
        self._registers = self._known(reading)
        return self.turns.follow(rows["position"], rows["velocity"], _seen(reading), reading.taken_ns)

    def _judge(
        self, reading: Reading, restarted: tuple[int, ...], jumped: np.ndarray
    ) -> tuple[tuple[Status, ...], tuple[int, ...]]:
        """Status and alert byte per servo, with restarts and hardware errors."""
        status = list(reading.status)
        for j, flag in enumerate(reading.alert):
            if status[j] is not Status.OK:
                continue
            if not flag:
                self._alert[j] = 0
            elif not self._alert[j]:
                self._alert[j] = self._upkeep.read_hardware_error(j) or 0x80
                _LOG.warning("%s: %s: %s", self._device, SERVOS[j], hardware_error_text(self._alert[j]))
            if flag:
                status[j] = Status.HARDWARE_ERROR
            elif jumped[j] or j in restarted or j in reading.revived:
                status[j] = Status.RESET
                self.doubtful |= bool(jumped[j])
        return tuple(status), tuple(self._alert)


def _seen(reading: Reading) -> np.ndarray:
    """(8,) bool, whether each servo answered."""
    if reading.status is ALL_OK:
        return ALL_SERVOS
    return np.array([s is Status.OK for s in reading.status])


class HealthSchedule:
    """Makes a health sample of a full read every `health_period_s`, and keeps it until `take`.

    Args:
        config: period of the samples.
        model: model of the servos.
        clock: bench clock.
        clipped: count of clipped goals, by servo; the first one hastens a sample, each sample zeroes it.
    """

    def __init__(self, config: ServosConfig, model: ServoModel, clock: Clock, clipped: list[int]) -> None:
        self._clipped, self._clips = clipped, False
        self._clock, self._volt = clock, model.table["present_input_voltage"].scale
        self._period_ns = nanoseconds(config.health_period_s)
        self._due_ns = clock.now_ns() + self._period_ns
        self._look_ns = clock.now_ns() + self._period_ns // _LOOKS
        self._sequence = 0
        self._kept: tuple[ServoHealth, ...] = ()

    def due(self) -> bool:
        """Whether the next read should be a full read."""
        if not self._clips and any(self._clipped):
            self._clips = True
            self._due_ns = self._look_ns = self._clock.now_ns()
        return self._clock.now_ns() >= self._look_ns

    def note(self, reading: Reading) -> None:
        """Take a full read; it becomes a sample when one is due and any servo has answered."""
        now_ns = self._clock.now_ns()
        self._look_ns = now_ns + self._period_ns // _LOOKS
        if now_ns < self._due_ns:
            return
        self._due_ns = max(self._due_ns + self._period_ns, now_ns)
        known = np.array([s is Status.OK for s in reading.status])
        if not known.any():
            return
        self._sequence += 1
        rows = reading.registers
        self._kept = (
            ServoHealth(
                Stamp(reading.taken_ns, reading.received_ns, self._sequence),
                np.where(known, np.array(rows["voltage"]) * self._volt, np.nan),
                np.where(known, rows["temperature"], np.nan),
                reading.status,
                tuple(self._clipped),
            ),
        )
        self._clips, self._clipped[:] = any(self._clipped), [0] * len(SERVOS)

    def take(self) -> tuple[ServoHealth, ...]:
        """The sample that was made since the last call, if any."""
        kept, self._kept = self._kept, ()
        return kept
