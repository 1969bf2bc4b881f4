"""Eight Dynamixel servos of one model as actuators: four drives by velocity, four steers by position.

One group read and one group write per cycle; per-servo status, never a number that stands for "no
data"; positions that count on across restarts. The zero of an angle is the servo's centre, 2048 counts.
The model is read at open, and gives control table, units and limits.
Measured behaviour that the driver passes on as it is: Present Velocity lags the encoder by 52 ms and is
truncated towards zero (authors' recordings); the stamp is that of the position.

This module has the sequence of opening and of a cycle. Reads are in `cyclic_read`, samples in
`servo_samples`, goals in `goal_values` and their packet in `packets`, the contents of RAM in `recovery`, the
time after which a fault is an error in `answer_timeouts`.
"""

import logging
import threading
from collections import Counter
from collections.abc import Mapping

import numpy as np

from hil.config.servo_models import ServoModel
from hil.config.servo_models.x_series_codes import RETURN_DELAY_STEP_S
from hil.config.servos import ServosConfig
from hil.core.clock import Clock, nanoseconds
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.finding import Finding
from hil.core.interfaces import Actuators
from hil.core.signals import SERVOS, ServoHealth, ServoHold, ServoSample, ServoSetpoint, Status
from hil.drivers.servos.dynamixel import bus_checks
from hil.drivers.servos.dynamixel import expected_servos as ident
from hil.drivers.servos.dynamixel.answer_timeouts import AnswerTimeouts
from hil.drivers.servos.dynamixel.bus import Bus
from hil.drivers.servos.dynamixel.cyclic_read import CycleReader, Reading
from hil.drivers.servos.dynamixel.goal_values import Goals
from hil.drivers.servos.dynamixel.keep_alive import KeepAlive
from hil.drivers.servos.dynamixel.packets import GoalWrite
from hil.drivers.servos.dynamixel.recovery import ANSWERING, RamRecovery, acknowledge_all
from hil.drivers.servos.dynamixel.register_map import RegisterMap
from hil.drivers.servos.dynamixel.sdk_port import ServoPort
from hil.drivers.servos.dynamixel.servo_samples import HealthSchedule, Samples
from hil.streams.silence_limit import used_while_closed

_LOG = logging.getLogger(__name__)
_OK = Status.OK

_PAUSE_NS = 200_000_000
_READ_ATTEMPTS = 3
_PATIENCE_NS, _RETRY_NS = nanoseconds(1.5), nanoseconds(0.02)
"""Longest wait for servos that fall silent in `enable`, as in `open`; time between two attempts."""


class DynamixelServos(Actuators):
    """The servo bus.

    Args:
        config: port, IDs, expectations, budgets.
        clock: the bench clock; every wait and every stamp is on it.

    Attributes:
        restarts: restarts found since this object was made, by servo name.
    """

    name = "servos"

    def __init__(self, config: ServosConfig, clock: Clock) -> None:
        self.restarts: Counter[str] = Counter()
        self._config, self._clock, self._prefetch = config, clock, config.prefetch
        self._bus: Bus | None = None
        self._identity: dict[str, str] = {}
        self._watchdog_ns = nanoseconds(config.watchdog_s)
        self._talking = threading.Lock()
        self._keep_alive = KeepAlive(clock, self._talking, self._visit, watchdog_s=config.watchdog_s)

    def open(self) -> None:
        """Open the port, check which servos are there and their settings, write RAM. Torque is left as it is.

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

    def _set_up(self, bus: Bus, *, last: bool = False) -> None:
        """Check the servos and write RAM; once more from the beginning where one falls silent meanwhile."""
        config = self._config
        acknowledge_all(bus, config.ids)
        answers = ident.read_blocks(bus, config, self._clock)
        model = ident.identified(bus, config, answers, self.name)
        self._registers = registers = RegisterMap(model)
        self._blocks = blocks = [a.data for a in answers]
        ident.check_setup(config, registers, blocks, self.name)
        delays = [registers.from_block(b, "return_delay_time") for b in blocks]
        bus.port.return_delay_s = max(delays) * RETURN_DELAY_STEP_S
        fast = ident.reads_fast(config, registers, blocks)
        self._upkeep = RamRecovery(bus, config, registers, self.name, fast=fast)
        try:
            self._upkeep.prepare(blocks)
        except DeviceTimeoutError as error:
            if last:
                raise
            _LOG.warning("%s; everything once more", error)
            return self._set_up(bus, last=True)
        mapped = self._upkeep.mapped
        self._cycle = CycleReader(bus, config, registers, self._clock, fast=fast, mapped=mapped)
        self._outage = AnswerTimeouts(config, self.name, self._clock.now_ns())
        goals_at = registers.goal_data if mapped else registers.goal_addresses
        self._goals = Goals(config, registers, blocks, GoalWrite(config.ids, goals_at), self.name)
        self._health = HealthSchedule(config, model, self._clock, self._goals.clipped)
        self._samples = Samples(registers, blocks, self._upkeep, self._clock, self.name)
        self._doubtful = self._commanded = self._paused = False
        self._identity = ident.described(config, registers, blocks)

    def close(self) -> None:
        """Bring the wheels to rest and close the port; torque stays as it is. Idempotent."""
        self._keep_alive.end()
        with self._talking:
            if self._bus is None:
                return
            if self._identity and self._upkeep.torque:
                self._rest(self._bus)
            self._identity = {}
            self._bus.close()
            self._bus = None

    def identity(self) -> Mapping[str, str]:
        """Models, firmware, IDs and port; empty while closed."""
        return self._identity

    @property
    def model(self) -> ServoModel:
        """The model of all eight servos, as read at open."""
        self._opened()
        return self._registers.model

    def _opened(self) -> Bus:
        if self._bus is None:
            raise used_while_closed(self.name, self._config.port)
        return self._bus

    def ask(self) -> None:
        """Send the request of the next `read`, unless it is pending already."""
        with self._talking:
            self._ask(self._opened())

    def _ask(self, bus: Bus) -> None:
        silence_ns = self._clock.now_ns() - bus.traffic_ns
        self._paused = self._tripped_by(silence_ns)
        if self._cycle.asked():
            self._doubtful |= self._paused
            return
        if silence_ns > _PAUSE_NS:
            self._outage.skip_pause(silence_ns)
        self._cycle.ask(full=self._paused or self._look_closely())

    def _tripped_by(self, silence_ns: int) -> bool:
        """Whether watchdogs may have tripped: half their time without requests, as clocks differ."""
        return self._upkeep.torque and silence_ns > self._watchdog_ns // 2 > 0

    def read(self) -> tuple[ServoSample, ...]:
        """One group read as one sample.

        Raises:
            DeviceTimeoutError: a servo has not answered usably for `fail_after_s`.
            DeviceError: a servo has reported a hardware error for `fail_after_s`.
        """
        with self._talking:
            return (self._read(self._opened()),)

    def _read(self, bus: Bus) -> ServoSample:
        self._ask(bus)
        reading = self._cycle.read()
        restarted: tuple[int, ...] = ()
        if reading.full:
            self._doubtful = False
            self._health.note(reading)
            restarted = self._audit(reading)
        self._paused = False
        sample = self._samples.sample(reading, restarted)
        self._doubtful |= self._samples.doubtful or _OK not in sample.status
        self._outage.note(sample.status, sample.alert, sample.stamp.host_ns)
        if self._prefetch and not self._commanded:
            self._cycle.ask(full=self._look_closely())
        self._commanded = False
        self._keep_alive.attended(sample.stamp.host_ns)
        return sample

    def _look_closely(self) -> bool:
        """Whether the next read should be a full read, with torque, watchdogs and health."""
        return self._doubtful or self._health.due()

    def _audit(self, reading: Reading) -> tuple[int, ...]:
        """Check torque and watchdogs by a full read; repair them with goals at which nothing moves."""
        state = self._upkeep.judge(reading)
        held = self._goals.still(self._samples.registers(reading))
        lost = [j for j, status in enumerate(reading.status) if status is Status.RESET]
        self.restarts.update(SERVOS[j] for j in lost)
        if not self._upkeep.torque:
            for j in lost:
                self._upkeep.restore(j)
                self._samples.turns.restarted(j)
        repaired = self._upkeep.repair(state, held.tolist(), paused=self._paused)
        self._goals.keep(repaired, held)
        for j in repaired:
            if state[j][0] == 0:
                self._samples.turns.restarted(j)
                self.restarts[SERVOS[j]] += j not in lost
        return repaired

    def read_health(self) -> tuple[ServoHealth, ...]:
        """Voltage and temperature of a full read, every `health_period_s`; empty in between."""
        self._opened()
        return self._health.take()

    def enable(self) -> None:
        """Goal := present, watchdog armed, torque on; checked. Servos that fall silent are waited for.

        Raises:
            DeviceError: a servo does not answer for 1.5 s, has a hardware error or did not take its torque.
        """
        with self._talking:
            bus = self._opened()
            self._keep_alive.begin()
            end_ns = self._clock.now_ns() + _PATIENCE_NS
            while not self._enable(bus, last=self._clock.now_ns() >= end_ns):
                self._clock.sleep_until_ns(self._clock.now_ns() + _RETRY_NS)

    def _enable(self, bus: Bus, *, last: bool) -> bool:
        """One attempt; False where it is worth another: a silent servo may be starting up after a dip."""
        try:
            self._await_answers(bus)
            self._upkeep.audit(self._cycle.live_ids)
            self._goals.hold(self._samples.registers())
            self._upkeep.refuse_hardware_errors()
            self._upkeep.torque = True  # from here on a servo without torque has restarted
            self._upkeep.switch_on(self._goals.packet(), self._cycle.live_ids)
            self._read(bus)
        except DeviceError:
            self._upkeep.torque = True  # servos that answer are held all the same
            if last or any(self._upkeep.hardware_error):
                raise
            return False
        return True

    def _await_answers(self, bus: Bus) -> None:
        for _ in range(_READ_ATTEMPTS):
            sample = self._read(bus)
            if all(s in ANSWERING for s in sample.status):
                return
        raise DeviceTimeoutError(
            self.name,
            "cannot be enabled: "
            + ", ".join(f"{SERVOS[j]} {s.value}" for j, s in enumerate(sample.status) if s is not Status.OK),
            port=self._config.port,
            expected="an answer from all eight servos",
            remedy="check cable, power and IDs",
        )

    def command(self, setpoint: ServoSetpoint) -> None:
        """One write of the eight goals, clipped to the limits of bench and servos.

        Raises:
            UsageError: a goal is not a number.
        """
        with self._talking:
            bus = self._opened()
            self._goals.follow(setpoint, self._samples.turns.offset)
            self._commanded = True
            packet = self._goals.packet()
            if self._prefetch:
                self._cycle.ask(full=self._look_closely(), after=packet)
            else:
                bus.send(packet)
            self._keep_alive.attended(self._clock.now_ns())

    def stop(self) -> None:
        """Wheels at rest, steering held at its goals, torque stays on. Sent twice; never raises."""
        with self._talking:
            if self._bus is not None and self._identity:
                self._rest(self._bus)

    def _rest(self, bus: Bus) -> None:
        self._goals.rest()
        packet = self._goals.packet()
        for _ in range(2):
            bus.send(packet)

    def look_after(self) -> ServoHold:
        """A full read of all eight, silent ones too; restores what a restart or a watchdog has cost."""
        with self._talking:
            if self._bus is None or not self._identity:
                nothing = np.full(len(SERVOS), np.nan)
                return ServoHold(self._clock.now_ns(), nothing, False, dict.fromkeys(SERVOS, "closed"))
            return self._look(self._bus)

    def _visit(self) -> bool:
        return self._bus is None or not self._identity or not self._look(self._bus).trouble

    def _look(self, bus: Bus) -> ServoHold:
        self._paused = self._tripped_by(self._clock.now_ns() - bus.traffic_ns)
        self._goals.rest()
        bus.send(self._goals.packet())
        reading = self._cycle.look()
        self._health.note(reading)
        self._audit(reading)
        position = self._samples.position(reading)
        now_ns = self._clock.now_ns()
        self._outage.record(reading.status, now_ns)
        self._keep_alive.attended(now_ns)
        self._upkeep.resend_torque(reading.status)
        trouble = self._upkeep.trouble(reading)
        upkeep = self._upkeep
        return ServoHold(now_ns, position, upkeep.torque, trouble, self._cycle.late(), upkeep.released)

    def release(self) -> None:
        """Torque off, checked: on a wall the robot slides.

        Raises:
            DeviceError: a servo still has torque on, or does not answer.
        """
        with self._talking:
            self._opened()
            self._keep_alive.end()
            self._upkeep.switch_off(self._cycle.live_ids)

    def diagnose(self) -> tuple[Finding, ...]:
        """Findings on the bus for `hil doctor`: reply time, firmware, return delay, kinds of packets."""
        with self._talking:
            reply = bus_checks.reply_time(self._opened(), self._config, self._clock, self.name)
        fast, mapped = self._cycle.fast, self._upkeep.mapped
        return reply, *bus_checks.findings(
            self._config, self._registers, self._blocks, self.name, fast=fast, mapped=mapped
        )
