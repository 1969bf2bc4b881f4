"""The fan's motor controller on CAN: a VESC that obeys, reports, protects itself and times out.

After `timeout_s` without a `SET_*` frame the motor is released; any of them renews it, a ping does not.
Status messages are off as delivered. What is out of range is clipped, never refused. The force that the fan
gives goes to the plant; a robot that it has carried once falls when it stops.
"""

from __future__ import annotations

from collections.abc import Iterator

import can

from hil.config.adhesion import VescConfig
from hil.fakes.adhesion import frames
from hil.fakes.adhesion.fan import HIGHEST_DUTY, Demand, Fan
from hil.fakes.adhesion.options import AdhesionTruthOptions
from hil.fakes.can_wire import WIRE_FAULTS, CanChannel
from hil.fakes.faults import PERIODIC, STRIKES, DeviceFaults, Supported
from hil.fakes.plant_api import HoldingForces
from hil.fakes.tether import Start, Tether
from hil.fakes.world import NEVER_NS, Scheduled, World
from hil.vocabulary.clock import NS_PER_S, nanoseconds

FAN_FAULTS: Supported = {
    "off": (),
    "stuck": (),
    "garbage": (),
    "wrong": ("factor",),
    "slow": ("factor",),
    "delayed": ("delay_s",),
    "intermittent": PERIODIC,
    "corrupt": STRIKES,
    "brownout": (),
    "reset": (),
    "jump": ("speed_rpm",),
    "adhesion_loss": ("factor", "over_s"),
    **WIRE_FAULTS,
}
_TICK_NS, _QUICK_NS = 20_000_000, 5_000_000
_BOOT_NS = 500_000_000
_COUNTS_PER_TURN = 6
_WRONG, _JUMP_RPM, _DELAY_S = 1.3, 5000.0, 0.1
_SPEED_NOISE_RPM, _AMPS_NOISE_A = 15.0, 0.3


class VescNode(Scheduled):
    """A part of the world with a motor, on a CAN channel.

    Args:
        world: plant, seed and faults; the node registers itself.
        channel: the bus.
        config: its id, and the ratings of the fan.
        options: how it is set, and physics.
        name: of its faults.
    """

    def __init__(
        self,
        world: World,
        channel: CanChannel,
        config: VescConfig,
        options: AdhesionTruthOptions,
        name: str = "adhesion",
    ) -> None:
        self.name, self._world, self._channel = name, world, channel
        self._config, self._options = config, options
        known = world.plant.working_point
        self._point = HoldingForces(config.rated_force_n, 0.0) if known is None else known
        self.fan = Fan(config, options, self._point.fan_gain)
        self._rng = world.rng(name)
        self._faults = DeviceFaults(world.faults, name, world.rng(f"{name}.faults"))
        world.faults.declare(name, FAN_FAULTS)
        self._queue = channel.listen()
        self._timeout_ns = nanoseconds(options.timeout_s)
        self._commanded_ns = 0
        self._booted_ns = 0
        self._dead = False
        self._turned = 0.0
        self._seen_ns = 0
        self._frozen: dict[int, bytes] = {}
        self._offset_rpm = 0.0
        phase_ns = int(self._rng.integers(1, _TICK_NS))
        self._tick_ns = phase_ns
        rates = ((options.rate_1_hz, options.messages_1), (options.rate_2_hz, options.messages_2))
        self._due_ns = [phase_ns if rate_hz > 0.0 and which else NEVER_NS for rate_hz, which in rates]
        self._periods_ns = [round(NS_PER_S / rate_hz) if rate_hz > 0.0 else NEVER_NS for rate_hz, _ in rates]
        self.begin("tethered" if options.start == "by use" else options.start)
        world.add(self)

    def begin(self, start: Start) -> None:
        """How the robot hangs when the world begins."""
        self._tether = Tether(start, self._point.adhesion_n)
        if start == "running":
            self.fan.begin(self._config.speed_for_rpm(self._point.adhesion_n / self._point.fan_gain))
        self._press()

    def begin_in_use(self) -> None:
        """The bench in this process has kept the fan running, unless the options say otherwise."""
        self.alone = True  # nobody in this world waits for its frames
        if self._options.start == "by use":
            self.begin("running")

    def next_due_ns(self) -> int:
        """Time of the next command that arrives, report, time-out or step of the physics."""
        due_ns = min(self._tick_ns, self._due_ns[0], self._due_ns[1])
        return min(due_ns, self._queue[0][0]) if self._queue else due_ns

    def on_due(self, t_ns: int) -> None:
        """Do everything that is due."""
        self._advance(t_ns)
        if not self._world.faults.empty:
            self._power(t_ns)
        while self._queue and self._queue[0][0] <= t_ns:
            self._take(self._queue.popleft()[1], t_ns)
        if self._timeout_ns and t_ns - self._commanded_ns >= self._timeout_ns:
            self.fan.demand = Demand()
        for rate in (0, 1):
            if self._due_ns[rate] <= t_ns:
                self._report(rate, t_ns)
        if self._tick_ns <= t_ns:
            quick = not self.fan.settled or self.fan.strength < 1.0
            self._tick_ns = t_ns + (_QUICK_NS if quick else _TICK_NS)
            if self._timeout_ns and self.fan.demand.mode != "released":
                self._tick_ns = min(self._tick_ns, self._commanded_ns + self._timeout_ns)
        self._press()

    def _advance(self, t_ns: int) -> None:
        """Physics up to now."""
        turns = (t_ns - self._seen_ns) / NS_PER_S * self.fan.speed_rpm / 60.0
        self._turned += turns * self._config.pole_pairs * _COUNTS_PER_TURN
        self._seen_ns = t_ns
        self.fan.strength = self._strength(t_ns)
        self.fan.advance(t_ns)

    def _strength(self, t_ns: int) -> float:
        """What a fault has left of the motor's power."""
        fault = self._faults.find("adhesion_loss", t_ns)
        if fault is None:
            return 1.0
        return fault.faded(t_ns, fault.option("factor", 0.0), fault.option("over_s", 0.0))

    def _press(self) -> None:
        force_n = self._tether.force_n(self.fan.force_n)
        self._world.plant.set_adhesion(force_n)

    def _power(self, t_ns: int) -> None:
        """Follow faults of the supply: without it the motor is free, with it the controller starts anew."""
        was_dead, self._dead = self._dead, any(self._faults.find(k, t_ns) for k in ("off", "brownout"))
        if self._dead:
            self.fan.demand = Demand()
        elif was_dead or self._faults.news("reset", t_ns):
            self._booted_ns, self.fan.demand = t_ns + _BOOT_NS, Demand()
        if (fault := self._faults.news("jump", t_ns)) is not None:
            self._offset_rpm += fault.option("speed_rpm", _JUMP_RPM)

    def _asleep(self, t_ns: int) -> bool:
        return self._dead or t_ns < self._booted_ns

    def _take(self, message: can.Message, t_ns: int) -> None:
        """A frame from the bus."""
        command, receiver = message.arbitration_id >> 8, message.arbitration_id & 0xFF
        if not message.is_extended_id or message.is_error_frame or message.is_remote_frame:
            return
        if self._asleep(t_ns) or receiver not in (self._config.controller_id, frames.EVERYBODY):
            return
        data = bytes(message.data)
        if command in frames.SET_COMMANDS:
            self._obey(command, frames.command_value(command, data), t_ns)
        elif command == frames.PING and data:
            self._send(frames.PONG << 8 | data[0], bytes((self._config.controller_id, 0)), t_ns)
        elif command == frames.SHORT_BUFFER and len(data) >= 3:
            self._answer(data[0], data[2], t_ns)

    def _obey(self, command: int, value: float | None, t_ns: int) -> None:
        """A `SET_*` command; what is out of range is clipped."""
        if value is None:
            return
        self._commanded_ns = t_ns
        limit_a = self._options.highest_a
        if command == frames.SET_DUTY:
            self.fan.demand = Demand("duty", min(max(value, -HIGHEST_DUTY), HIGHEST_DUTY))
        elif command == frames.SET_RPM:
            self.fan.demand = Demand("rpm", value / self._config.pole_pairs)
        elif command in (frames.SET_CURRENT, frames.SET_CURRENT_REL):
            amps = value * (limit_a if command == frames.SET_CURRENT_REL else 1.0)
            self.fan.demand = Demand("current", min(max(amps, -limit_a), limit_a)) if amps else Demand()
        else:
            self.fan.demand = Demand("brake")

    def _answer(self, asker_id: int, question: int, t_ns: int) -> None:
        """Firmware and settings, to whoever asks."""
        o = self._options
        if question == frames.FW_VERSION:
            payload = frames.firmware_reply(o.firmware)
        elif question == frames.GET_APPCONF:
            masks = tuple(sum(1 << (m - 1) for m in which) for which in (o.messages_1, o.messages_2))
            payload = frames.settings_reply(
                self._config.controller_id, o.timeout_s, (o.rate_1_hz, o.rate_2_hz), (masks[0], masks[1])
            )
        else:
            return
        for frame_id, data in frames.in_pieces(self._config.controller_id, asker_id, payload):
            self._send(frame_id, data, t_ns)

    def _report(self, rate: int, t_ns: int) -> None:
        """The status messages of one of the two rates."""
        slow = self._faults.find("slow", t_ns)
        self._due_ns[rate] += round(self._periods_ns[rate] * (1.0 if slow is None else slow.slowness))
        fault = self._faults.find("intermittent", t_ns)
        if self._asleep(t_ns) or (fault is not None and fault.interrupts(t_ns)):
            return
        delayed = self._faults.find("delayed", t_ns)
        send_ns = t_ns + (delayed.delay_ns(_DELAY_S) if delayed is not None else 0)
        which = self._options.messages_2 if rate else self._options.messages_1
        for command, data in self._messages(which):
            if not self._world.faults.empty:
                data = self._spoilt(command, data, t_ns)
            self._send(command << 8 | self._config.controller_id, data, send_ns)

    def _messages(self, which: tuple[int, ...]) -> Iterator[tuple[int, bytes]]:
        """Command and data of status messages by their numbers."""
        fan = self.fan
        for number in which:
            if number == 1:
                noise = self._rng.standard_normal(2)
                rpm = fan.speed_rpm + self._offset_rpm + (_SPEED_NOISE_RPM * noise[0] if fan.speed_rpm else 0)
                amps = fan.motor_a + (_AMPS_NOISE_A * noise[1] if fan.motor_a else 0.0)
                yield 9, frames.status_1(self._config.pole_pairs * rpm, amps, fan.duty)
            elif number in (2, 3):
                yield 12 + number, frames.status_2(0.0)
            elif number == 4:
                yield 16, frames.status_4(fan.fet_c, self._options.ambient_c, fan.input_a)
            elif number == 5:
                yield 27, frames.status_5(self._turned, fan.input_v)
            elif number == 6:
                yield 58, frames.status_6()

    def _spoilt(self, command: int, data: bytes, t_ns: int) -> bytes:
        """A report under the faults that are active."""
        find = self._faults.find
        wrong = find("wrong", t_ns)
        if wrong is not None and command == 9:
            erpm = int.from_bytes(data[:4], "big", signed=True) * wrong.option("factor", _WRONG)
            data = frames.clipped(erpm, 32).to_bytes(4, "big", signed=True) + data[4:]
        if find("stuck", t_ns) is not None:
            data = self._frozen.setdefault(command, data)
        else:
            self._frozen.clear()
        if find("garbage", t_ns) is not None:
            data = self._rng.bytes(len(data))
        corrupt = find("corrupt", t_ns)
        if corrupt is not None and corrupt.strikes(self._rng):
            bit = int(self._rng.integers(8 * len(data)))
            spoilt = bytearray(data)
            spoilt[bit // 8] ^= 1 << bit % 8
            data = bytes(spoilt)
        return data

    def _send(self, frame_id: int, data: bytes, t_ns: int) -> None:
        """Put a frame on the bus, once for every controller that has this id."""
        for _ in range(1 + self._options.twins):
            message = can.Message(arbitration_id=frame_id, data=data, is_extended_id=True)
            self._channel.send(message, t_ns, sender=self._queue)
