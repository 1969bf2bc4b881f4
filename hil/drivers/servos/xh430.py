"""Eight XH430 servos as the robot's actuators: four drives in velocity mode, four steers in position mode.

One group read and one group write per cycle; per-servo status, never a number that stands for "no
data"; positions that count on across restarts. The zero of an angle is the servo's centre, 2048 counts.
Measured behaviour that the driver passes on as it is: Present Velocity lags the encoder by 52 ms and is
truncated towards zero (`facts/robot.md`); the stamp is that of the position.

Here is what happens when: opening, the order of a cycle, the sample. What a read is made of is in `cycle`,
what the goals are in `goals`, what RAM must hold in `upkeep`, when a fault becomes an error in `outage`.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping

import numpy as np

from hil.clock import Clock, nanoseconds
from hil.config.servos import ServosConfig
from hil.config.xh430 import (
    A_PER_COUNT,
    RAD_PER_COUNT,
    RAD_S_PER_COUNT,
    ZERO_COUNTS,
    hardware_error_text,
)
from hil.drivers.servos import identity as ident
from hil.drivers.servos import registers as reg
from hil.drivers.servos.bus import Bus
from hil.drivers.servos.cycle import ALL_OK, CycleReader, Reading
from hil.drivers.servos.goals import Goals
from hil.drivers.servos.health import HealthWatch
from hil.drivers.servos.outage import OutageWatch
from hil.drivers.servos.port import ServoPort
from hil.drivers.servos.turns import TurnCounter
from hil.drivers.servos.upkeep import Upkeep
from hil.errors import DeviceError, DeviceTimeoutError
from hil.finding import Finding
from hil.interfaces import Actuators
from hil.signals import SERVOS, ServoHealth, ServoSample, ServoSetpoint, Stamp, Status

_LOG = logging.getLogger(__name__)

_PAUSE_NS = 200_000_000
_NO_ALERT: tuple[int, ...] = (0,) * 8
_ALL_SEEN = np.ones(8, dtype=bool)
_SPEED_COUNTS = RAD_S_PER_COUNT / RAD_PER_COUNT
_READ_ATTEMPTS = 3


class XH430Servos(Actuators):
    """The servo bus.

    Args:
        config: port, IDs, expectations, budgets.
        clock: the bench clock; every wait and every stamp is on it.
        name: device name in errors and logs.
    """

    def __init__(self, config: ServosConfig, clock: Clock, name: str = "servos") -> None:
        self.name = name
        self._config, self._clock = config, clock
        self._bus: Bus | None = None
        self._identity: dict[str, str] = {}
        self._watchdog_ns = nanoseconds(config.watchdog_s)
        self._sequence = 0

    def open(self) -> None:
        """Open the port, check who is there and how they are set up, write RAM. Torque is left as it is.

        Raises:
            DeviceError: port, identity or EEPROM are not as expected; the message has a table.
        """
        self.close()
        config = self._config
        port = ServoPort(
            config.port,
            config.baud,
            self._clock,
            latency_s=config.usb_latency_s,
            slack_s=config.reply_slack_s,
        )
        port.open(self.name)
        self._bus = bus = Bus(port, self._clock, self.name)
        try:
            with port.patient():
                self._set_up(bus)
        except BaseException:
            self.close()
            raise

    def _set_up(self, bus: Bus) -> None:
        config = self._config
        Upkeep(bus, config, self.name, fast=False).acknowledge_all()
        answers = ident.read_blocks(bus, config, self._clock)
        ident.check_identity(bus, config, answers, self.name)
        self._blocks = blocks = [a.data for a in answers]
        ident.check_setup(config, blocks, self.name)
        bus.port.return_delay_s = max(reg.from_block(b, "return_delay_time") * 2e-6 for b in blocks)
        fast = ident.reads_fast(config, blocks)
        self._upkeep = Upkeep(bus, config, self.name, fast=fast)
        self._upkeep.prepare(blocks)
        self._cycle = CycleReader(bus, config, self._clock, fast=fast, mapped=self._upkeep.mapped)
        self._health = HealthWatch(config, self._clock)
        self._outage = OutageWatch(config, self.name, self._clock.now_ns())
        self._goals = Goals(config, blocks, self._upkeep.goal_write(), self.name)
        self._turns = TurnCounter()
        self._registers = np.array([reg.from_block(b, "present_position") for b in blocks], dtype=np.int64)
        self._alert = [0] * 8
        self._doubtful = self._commanded = self._paused = False
        self._identity = ident.described(config, blocks)

    def close(self) -> None:
        """Bring the wheels to rest and let go of the port; torque stays as it is. Idempotent."""
        if self._bus is None:
            return
        if self._identity and self._upkeep.torque:
            self.stop()
        self._identity = {}
        self._bus.close()
        self._bus = None

    def identity(self) -> Mapping[str, str]:
        """Models, firmware, IDs and port; empty while closed."""
        return self._identity

    def _opened(self) -> Bus:
        if self._bus is None:
            raise DeviceError(
                self.name, "used while closed", port=self._config.port, remedy="call open() first"
            )
        return self._bus

    def ask(self) -> None:
        """Send the request of the next `read`, unless that has been done right after a command."""
        bus = self._opened()
        if self._cycle.asked():
            return
        silence_ns = self._clock.now_ns() - bus.traffic_ns
        if silence_ns > _PAUSE_NS:
            self._outage.excuse(silence_ns)
        self._paused = self._upkeep.torque and silence_ns > self._watchdog_ns > 0
        self._cycle.ask(full=self._paused or self._look_closely())

    def read(self) -> tuple[ServoSample, ...]:
        """One group read as one sample.

        Raises:
            DeviceTimeoutError: a servo has not answered usably for `fail_after_s`.
            DeviceError: a servo has reported a hardware error for `fail_after_s`.
        """
        self.ask()
        reading = self._cycle.read()
        restarted: tuple[int, ...] = ()
        if reading.full:
            self._doubtful = False
            self._health.note(reading)
            restarted = self._audit(reading)
        self._paused = False
        self._doubtful |= bool(reading.revived)
        sample = self._sample(reading, restarted)
        if self._config.prefetch and not self._commanded:
            self._cycle.ask(full=self._look_closely())
        self._commanded = False
        return (sample,)

    def _look_closely(self) -> bool:
        """Whether the next read should show torque, watchdogs and health as well."""
        return self._doubtful or self._health.due()

    def _sample(self, reading: Reading, restarted: tuple[int, ...]) -> ServoSample:
        self._sequence += 1
        t_ns = reading.taken_ns
        stamp = Stamp(t_ns=t_ns, host_ns=self._clock.now_ns(), seq=self._sequence)
        rows = reading.registers
        velocity = rows["velocity"].astype(np.float64)
        clean = reading.status is ALL_OK
        seen = _ALL_SEEN if clean else np.array([s is Status.OK for s in reading.status])
        raw = rows["position"].astype(np.int64)
        self._registers = raw if clean else np.where(seen, raw, self._registers)
        counts, jumped = self._turns.follow(raw, velocity * _SPEED_COUNTS, seen, t_ns)
        position = (counts - ZERO_COUNTS) * RAD_PER_COUNT
        velocity *= RAD_S_PER_COUNT
        current = rows["current"] * A_PER_COUNT
        status = reading.status
        alert = _NO_ALERT
        if not clean or restarted or jumped.any() or any(self._alert):
            status, alert = self._judge(reading, restarted, jumped)
            bad = np.array([s is not Status.OK for s in status])
            position[bad] = velocity[bad] = current[bad] = np.nan
        self._outage.note(status, self._alert, stamp.host_ns)
        return ServoSample(stamp, position, velocity, current, status, alert)

    def _judge(
        self, reading: Reading, restarted: tuple[int, ...], jumped: np.ndarray
    ) -> tuple[tuple[Status, ...], tuple[int, ...]]:
        """Status and alert byte per servo, with restarts and hardware errors looked into."""
        status = list(reading.status)
        for j, flag in enumerate(reading.alert):
            if status[j] is not Status.OK:
                continue
            if not flag:
                self._alert[j] = 0
            elif not self._alert[j]:
                self._alert[j] = self._upkeep.read_hardware_error(j) or 0x80
                _LOG.warning("%s: %s: %s", self.name, SERVOS[j], hardware_error_text(self._alert[j]))
            if flag:
                status[j] = Status.HARDWARE_ERROR
            elif jumped[j] or j in restarted or j in reading.revived:
                status[j] = Status.RESET
                self._doubtful = self._doubtful or bool(jumped[j])
        return tuple(status), tuple(self._alert)

    def _audit(self, reading: Reading) -> tuple[int, ...]:
        """Judge by a full look whether torque and watchdogs are as they should be; repair, holding still."""
        state = self._upkeep.judge(reading)
        held = self._goals.still(self._registers)
        lost = [j for j, status in enumerate(reading.status) if status is Status.RESET]
        if not self._upkeep.torque:
            for j in lost:
                self._upkeep.restore(j)
                self._turns.restarted(j)
        repaired = self._upkeep.repair(state, held.tolist(), paused=self._paused)
        for j in repaired:
            if state[j][0] == 0:
                self._turns.restarted(j)
        return repaired

    def read_health(self) -> tuple[ServoHealth, ...]:
        """Voltage and temperature every `health_period_s`, as `read` has brought them; empty between."""
        self._opened()
        return self._health.take()

    def enable(self) -> None:
        """Goal := present, watchdog armed, torque on; checked.

        Raises:
            DeviceError: a servo does not answer, has a hardware error or did not take its torque.
        """
        self._opened()
        answering = (Status.OK, Status.RESET, Status.HARDWARE_ERROR)
        for _ in range(_READ_ATTEMPTS):
            sample = self.read()[0]
            if all(s in answering for s in sample.status):
                break
        else:
            raise DeviceTimeoutError(
                self.name,
                "cannot be enabled: " + ", ".join(
                    f"{SERVOS[j]} {s.value}" for j, s in enumerate(sample.status) if s is not Status.OK
                ),
                port=self._config.port,
                expected="an answer from all eight servos",
                remedy="check cable, power and IDs",
            )  # fmt: skip
        self._upkeep.audit(self._cycle.live_ids)
        self._upkeep.refuse_hardware_errors()
        self._goals.hold(self._registers)
        self._upkeep.switch_on(self._goals.packet(), self._cycle.live_ids)
        self.read()

    def command(self, setpoint: ServoSetpoint) -> None:
        """One write of the eight goals, clipped to the limits of bench and servos.

        Raises:
            UsageError: a goal is not a number.
        """
        bus = self._opened()
        self._goals.follow(setpoint, self._turns.offset)
        self._commanded = True
        packet = self._goals.packet()
        if self._config.prefetch:
            self._cycle.ask(full=self._look_closely(), after=packet)
        else:
            bus.send(packet)

    def stop(self) -> None:
        """Wheels at rest, steering held at its goals, torque stays on. Sent twice; never raises."""
        if self._bus is None or not self._identity:
            return
        self._goals.rest()
        packet = self._goals.packet()
        for _ in range(2):
            self._bus.send(packet)

    def release(self) -> None:
        """Torque off, checked: on a wall the robot slides.

        Raises:
            DeviceError: a servo still has torque on, or does not say.
        """
        self._opened()
        self._upkeep.switch_off(self._cycle.live_ids)

    def diagnose(self) -> tuple[Finding, ...]:
        """Facts about the bus for `hil doctor`: firmware, return delay, errors, kinds of packets."""
        self._opened()
        fast, mapped = self._cycle.fast, self._upkeep.mapped
        return ident.findings(self._config, self._blocks, self.name, fast=fast, mapped=mapped)
