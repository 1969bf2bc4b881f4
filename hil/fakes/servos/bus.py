"""Eight emulated XH430 on one half-duplex bus: who hears what, who answers when.

Everything here is timing and addressing; a servo's own behaviour is in `servo.py`. The bus is a part
of the world that ticks every 4 ms: measurement grid, profiles, bus watchdogs, and every 0.1 s heat,
voltage and overload.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hil.config.xh430 import TABLE
from hil.fakes.servos import protocol
from hil.fakes.servos.faulty import BUS_FAULTS, ServoFaults
from hil.fakes.servos.options import ServoBusOptions
from hil.fakes.servos.protocol import Instruction, InstructionParser
from hil.fakes.servos.sensing import GRID_NS, Sensing
from hil.fakes.servos.servo import Servo
from hil.fakes.wire import Reply, SerialChip
from hil.fakes.world import Scheduled, World

_BAUD_TOLERANCE = 0.03
_SLOW_TICKS = 25
_SLOW_S = _SLOW_TICKS * GRID_NS * 1e-9
_WATCHDOG_STEP_NS = 20_000_000
_HEATING_K_PER_W, _HEATING_S = 4.0, 300.0
_VOLTAGE, _OVERHEATED, _OVERLOAD = 0x01, 0x04, 0x20
_CYCLIC_FIRST = TABLE["present_current"].address
_CYCLIC_END = TABLE["present_position"].address + 4
_FAST_FIRMWARE = 45

Wanted = list[tuple[int, int, int]]
Answer = tuple[int, bytes] | None


class ServoBus(SerialChip, Scheduled):
    """A `SerialChip` with eight servos behind it, joint by joint as in `hil.signals.SERVOS`.

    Args:
        world: plant, seed and faults; the bus registers itself as a part.
        name: device name, also of its faults.
        options: how the servos are set up and supplied.
    """

    def __init__(self, world: World, name: str = "servos", options: ServoBusOptions | None = None) -> None:
        self.name = name
        self.supported_faults = BUS_FAULTS
        self.options = options = options if options is not None else ServoBusOptions()
        self._world = world
        self._rng = rng = world.rng(name)
        self._faults = ServoFaults(world.faults, name, options.ids, rng)
        self._sensing = Sensing(world.plant, rng)
        self.servos = tuple(Servo(j, world.plant, options) for j in range(8))
        encoder = self._sensing.counts()
        for servo in self.servos:
            servo.boot(0, encoder[servo.joint])
            servo.busy_until_ns = 0
        self._parser = InstructionParser()
        self._baud = 0
        self._processing_ns = round(options.processing_s * 1e9)
        self._due_ns = GRID_NS
        self._ticks = 0
        self._traffic_ns = 0
        self._celsius = np.full(8, options.ambient_c)
        self._volts = options.supply_v
        self._overloaded_s = np.zeros(8)
        world.add(self)

    def next_due_ns(self) -> int:
        """Next point of the measurement grid."""
        return self._due_ns

    def on_due(self, t_ns: int) -> None:
        """One tick of the grid."""
        self._due_ns = t_ns + GRID_NS
        self._ticks += 1
        self._sensing.tick()
        if not self._world.faults.empty:
            self._follow_faults(t_ns)
        for servo in self.servos:
            if servo.trajectory.ongoing:
                servo.advance(GRID_NS * 1e-9)
        silence_ns = t_ns - self._traffic_ns
        if silence_ns >= _WATCHDOG_STEP_NS:
            self._watch(t_ns, silence_ns)
        if self._ticks % _SLOW_TICKS == 0:
            self._warm_and_wear()

    def reset(self, t_ns: int) -> None:
        """Power was cycled."""
        self._parser.reset()
        encoder = self._sensing.counts()
        for servo in self.servos:
            servo.dead = False
            servo.boot(t_ns, encoder[servo.joint])

    def receive(self, data: bytes, t_ns: int, baud: int) -> list[Reply]:
        """Answer instruction packets; servos set to another baud rate hear noise."""
        if not self._world.faults.empty:
            self._follow_faults(t_ns)
        if baud != self._baud:
            self._parser.reset()
            self._baud = baud
        first_ns = t_ns - max(0, len(data) - 1) * 10_000_000_000 // baud
        replies: list[Reply] = []
        for instruction in self._parser.feed(data, first_ns, t_ns):
            replies += self._execute(instruction, t_ns)
        return replies

    def _listeners(self, t_ns: int) -> list[Servo]:
        absent, low, high = self.options.absent, 1.0 - _BAUD_TOLERANCE, 1.0 + _BAUD_TOLERANCE
        baud = self._baud
        return [
            s
            for s in self.servos
            if not s.dead
            and t_ns >= s.busy_until_ns
            and low * s.baud <= baud <= high * s.baud
            and s.id not in absent
        ]

    def _execute(self, instruction: Instruction, t_ns: int) -> list[Reply]:
        listeners = self._listeners(t_ns)
        if not instruction.sound:
            return [
                r
                for s in listeners
                if s.id == instruction.servo_id
                for r in self._single(s, protocol.CRC_ERROR, b"", t_ns)
            ]
        self._traffic_ns = t_ns
        group = _GROUP_READS.get(instruction.code)
        if group is not None:
            wanted = group(instruction)
            if wanted is None:
                return []
            fast = instruction.code in (protocol.FAST_SYNC_READ, protocol.FAST_BULK_READ)
            return (self._fast_read if fast else self._read_in_turn)(wanted, listeners, t_ns)
        if instruction.code in (protocol.SYNC_WRITE, protocol.BULK_WRITE):
            if not all(s.torque for s in listeners):
                self._measure(listeners, t_ns)
            self._write_group(instruction, listeners)
            return []
        if instruction.code == protocol.PING and instruction.servo_id == protocol.BROADCAST:
            return self._roll_call(listeners, t_ns)
        replies = []
        for servo in [s for s in listeners if s.answers_to(instruction.servo_id)]:
            asked_id = servo.id
            answer = self._obey(servo, instruction, t_ns)
            if answer is None:
                continue
            level = 0 if instruction.code == protocol.PING else 1 if instruction.code == protocol.READ else 2
            if instruction.servo_id == asked_id and self._level(servo) >= level:
                replies += self._single(servo, *answer, t_ns, servo_id=asked_id)
            self._afterwards(servo, instruction, answer[0], t_ns)
        return _collided(replies)

    @staticmethod
    def _level(servo: Servo) -> int:
        return servo.table.get("status_return_level")

    def _single(
        self, servo: Servo, error: int, parameters: bytes, t_ns: int, servo_id: int | None = None
    ) -> list[Reply]:
        """A status packet, under the ID that was asked where the instruction has changed it."""
        sender = servo.id if servo_id is None else servo_id
        data = protocol.status(sender, error | servo.alert, parameters)
        ready_ns = t_ns + self._processing_ns + servo.delay_ns
        if self._world.faults.empty:
            return [Reply(ready_ns, data)]
        if self._faults.silent(servo.joint, t_ns):
            return []
        late_ns = self._faults.late_ns(servo.joint, t_ns)
        return [Reply(ready_ns + late_ns, self._faults.spoil(servo.joint, data, t_ns))]

    def _roll_call(self, listeners: list[Servo], t_ns: int) -> list[Reply]:
        slot_ns = round(self.options.ping_slot_s * 1e9)
        replies: list[Reply] = []
        for servo in sorted(listeners, key=lambda s: s.id):
            mine = self._single(servo, protocol.OK, self._ping(servo), t_ns + servo.id * slot_ns)
            if replies and mine and mine[0].ready_ns == replies[-1].ready_ns:
                mine = _collided([replies.pop(), *mine])
            replies += mine
        return replies

    @staticmethod
    def _ping(servo: Servo) -> bytes:
        return servo.table.get("model_number").to_bytes(2, "little") + bytes((servo.firmware,))

    def _obey(self, servo: Servo, instruction: Instruction, t_ns: int) -> Answer:
        """Carry out a single instruction; error number and parameters, None for no answer at all."""
        code, parameters = instruction.code, instruction.parameters
        if code == protocol.PING:
            return protocol.OK, self._ping(servo)
        if code == protocol.READ:
            return self._read(servo, parameters, t_ns)
        if code in (protocol.WRITE, protocol.REG_WRITE):
            return self._write(servo, parameters, t_ns, later=code == protocol.REG_WRITE), b""
        if code == protocol.ACTION:
            if servo.pending is None:
                return protocol.INSTRUCTION_ERROR, b""
            address, data = servo.pending
            servo.pending = None
            servo.table.put("registered_instruction", 0)
            self._measure([servo], t_ns)
            return servo.write(address, data), b""
        if code == protocol.REBOOT:
            return protocol.OK, b""
        if code == protocol.CLEAR:
            self._measure([servo], t_ns)
            right = parameters == b"\x01DXL\x22"
            return (servo.clear_turns() if right else protocol.DATA_RANGE), b""
        if code == protocol.BACKUP:
            return servo.back_up(parameters), b""
        if code == protocol.FACTORY_RESET:
            return self._check_factory_reset(servo, instruction)
        return protocol.INSTRUCTION_ERROR, b""

    @staticmethod
    def _check_factory_reset(servo: Servo, instruction: Instruction) -> Answer:
        if len(instruction.parameters) != 1 or instruction.parameters[0] not in (0xFF, 1, 2):
            return protocol.DATA_RANGE, b""
        everything = instruction.parameters[0] == 0xFF
        if everything and instruction.servo_id == protocol.BROADCAST and servo.firmware >= 42:
            return None
        return protocol.OK, b""

    def _afterwards(self, servo: Servo, instruction: Instruction, error: int, t_ns: int) -> None:
        """What happens once the answer has been given."""
        if error != protocol.OK:
            return
        if instruction.code == protocol.REBOOT:
            self._measure([servo], t_ns)
            servo.boot(t_ns, self._sensing.counts()[servo.joint])
        elif instruction.code == protocol.FACTORY_RESET:
            servo.factory_reset(instruction.parameters[0], t_ns)
        elif instruction.code == protocol.BACKUP and instruction.parameters[0] == 2:
            servo.restore(t_ns)

    def _read(self, servo: Servo, parameters: bytes, t_ns: int) -> tuple[int, bytes]:
        if len(parameters) != 4:
            return protocol.DATA_LENGTH, b""
        return self._read_range(servo, *_pair(parameters), t_ns)

    def _read_range(self, servo: Servo, address: int, length: int, t_ns: int) -> tuple[int, bytes]:
        self._refresh(servo, address, length, t_ns)
        data = servo.table.read(address, length)
        return (protocol.ACCESS, b"") if data is None else (protocol.OK, data)

    def _write(self, servo: Servo, parameters: bytes, t_ns: int, *, later: bool) -> int:
        if len(parameters) < 3:
            return protocol.DATA_LENGTH
        address, data = parameters[0] | parameters[1] << 8, parameters[2:]
        self._measure([servo], t_ns)
        error = servo.write(address, data, dry=later)
        if later and error == protocol.OK:
            servo.pending = (address, data)
            servo.table.put("registered_instruction", 1)
        return error

    def _write_group(self, instruction: Instruction, listeners: list[Servo]) -> None:
        """Sync and bulk write: no answers, each servo takes its part or refuses it in silence."""
        if instruction.servo_id != protocol.BROADCAST:
            return
        parts = _write_parts(instruction)
        for servo_id, address, data in parts:
            for servo in listeners:
                if servo_id in (servo.id, servo.secondary):
                    servo.write(address, data)

    def _read_in_turn(self, wanted: Wanted, listeners: list[Servo], t_ns: int) -> list[Reply]:
        """Sync and bulk read: each servo answers when the one before it has finished."""
        byte_ns = 10_000_000_000 // self._baud
        replies: list[Reply] = []
        free_ns = t_ns
        for servo_id, address, length in wanted:
            mine: list[Reply] = []
            for servo in listeners:
                if servo.id == servo_id and self._level(servo) >= 1:
                    error, data = self._read_range(servo, address, length, t_ns)
                    mine += self._single(servo, error, data, free_ns)
            if not mine:
                if self.options.after_absent == "silent":
                    break
                free_ns += self._processing_ns + (length + 11) * byte_ns
                continue
            for reply in _collided(mine):
                replies.append(reply)
                free_ns = reply.ready_ns + len(reply.data) * byte_ns
        return replies

    def _fast_read(self, wanted: Wanted, listeners: list[Servo], t_ns: int) -> list[Reply]:
        """Fast sync and bulk read: one packet that the servos write together."""
        by_id = {s.id: s for s in listeners if s.firmware >= _FAST_FIRMWARE and self._level(s) >= 1}
        if not self._world.faults.empty:
            by_id = {i: s for i, s in by_id.items() if not self._faults.silent(s.joint, t_ns)}
        parts, places = [], []
        for place, (servo_id, address, length) in enumerate(wanted):
            servo = by_id.get(servo_id)
            if servo is None:
                if self.options.after_absent == "silent":
                    break
                continue
            error, data = self._read_range(servo, address, length, t_ns)
            parts.append((servo_id, error | servo.alert, data if data else bytes(length)))
            places.append((place, servo))
        if not parts:
            return []
        declared = 1 + sum(length + 4 for _, _, length in wanted)
        pieces = protocol.fast_status(parts, declared)
        if places[0][0]:
            pieces[0] = pieces[0][8:]
        ready_ns = t_ns + self._processing_ns + max(s.delay_ns for _, s in places)
        if len(pieces) == len(wanted) and self._world.faults.empty:
            return [Reply(ready_ns, b"".join(pieces))]
        return self._spaced(pieces, places, wanted, ready_ns, t_ns)

    def _spaced(
        self, pieces: list[bytes], places: list[tuple[int, Servo]], wanted: Wanted, ready_ns: int, t_ns: int
    ) -> list[Reply]:
        """Pieces of a fast reply with holes where servos are missing, spoilt one by one."""
        byte_ns = 10_000_000_000 // self._baud
        replies, next_place = [], 0
        for piece, (place, servo) in zip(pieces, places, strict=True):
            ready_ns += sum((wanted[k][2] + 4) * byte_ns for k in range(next_place, place))
            ready_ns += self._faults.late_ns(servo.joint, t_ns)
            replies.append(Reply(ready_ns, self._faults.spoil(servo.joint, piece, t_ns)))
            ready_ns += len(piece) * byte_ns
            next_place = place + 1
        return replies

    def _refresh(self, servo: Servo, address: int, length: int, t_ns: int) -> None:
        """Bring the live registers of a read range up to date."""
        end = address + length
        if end <= 120 or 147 <= address < 224:
            return
        velocity, current = self._measure_one(servo, t_ns)
        if address >= _CYCLIC_FIRST and end <= _CYCLIC_END:
            servo.show_motion(velocity, current)
            return
        duty = float(self._sensing.duty(self._volts)[servo.joint])
        celsius = int(self._celsius[servo.joint])
        servo.show(t_ns, velocity, current, duty, int(self._volts * 10), celsius)

    def _measure(self, servos: list[Servo], t_ns: int) -> None:
        for servo in servos:
            self._measure_one(servo, t_ns)

    def _measure_one(self, servo: Servo, t_ns: int) -> tuple[int, int]:
        """Let a servo sense; its velocity and current counts in the joint's direction."""
        stamp = (t_ns, self._ticks)
        if self._cache_stamp != stamp:
            self._cache_stamp = stamp
            sensing = self._sensing
            self._cache = (sensing.counts(), sensing.velocity(), sensing.current())
        j = servo.joint
        counts, velocity, current = (row[j] for row in self._cache)
        if not self._world.faults.empty:
            age_ns = self._faults.age_ns(j, t_ns)
            if age_ns:
                counts, velocity = self._sensing.counts(age_ns)[j], self._sensing.velocity(age_ns)[j]
            counts, velocity, current = self._faults.measured(j, t_ns, (counts, velocity, current))
        servo.sense(counts, velocity)
        return velocity, current

    _cache_stamp: tuple[int, int] = (-1, -1)
    _cache: tuple[list[int], list[int], list[int]] = ([], [], [])

    def _follow_faults(self, t_ns: int) -> None:
        """Power, resets and slips that faults bring about."""
        for servo in self.servos:
            j = servo.joint
            if self._faults.unpowered(j, t_ns):
                if not servo.dead:
                    servo.lose_power()
                continue
            if servo.dead or self._faults.due_once(j, "reset", t_ns) is not None:
                servo.dead = False
                servo.boot(t_ns, self._sensing.counts()[j])
            slip = self._faults.jump_counts(j, t_ns)
            if slip:
                servo.slip(slip)

    def _watch(self, t_ns: int, silence_ns: int) -> None:
        for servo in self.servos:
            limit_ns = servo.watchdog_ns()
            if limit_ns and silence_ns > limit_ns:
                self._measure([servo], t_ns)
                servo.trip()

    def _warm_and_wear(self) -> None:
        """Heat by current, voltage drop, and the errors that come of it."""
        options = self.options
        current = np.abs(self._sensing.currents_a())
        self._volts = options.supply_v - options.supply_ohm * float(current.sum())
        target = options.ambient_c + _HEATING_K_PER_W * 9.23 * current**2
        self._celsius += (target - self._celsius) * (_SLOW_S / _HEATING_S)
        heavy = current >= options.overload_a
        self._overloaded_s = np.where(heavy, self._overloaded_s + _SLOW_S, 0.0)
        for servo in self.servos:
            if not servo.dead:
                self._judge(servo, bool(self._overloaded_s[servo.joint] >= options.overload_s))

    def _judge(self, servo: Servo, overloaded: bool) -> None:
        get = servo.table.get
        bits = _OVERLOAD if overloaded else 0
        if self._celsius[servo.joint] > get("temperature_limit"):
            bits |= _OVERHEATED
        if not get("min_voltage_limit") <= self._volts * 10 <= get("max_voltage_limit"):
            bits |= _VOLTAGE
        if bits & ~get("hardware_error_status"):
            servo.raise_error(bits)


def _pair(data: bytes) -> tuple[int, int]:
    return data[0] | data[1] << 8, data[2] | data[3] << 8


def _collided(replies: list[Reply]) -> list[Reply]:
    """Servos with the same ID talk at once: what is left on the line is nobody's packet."""
    if len(replies) < 2:
        return replies
    longest = max(len(r.data) for r in replies)
    mixed = bytearray(b"\xff" * longest)
    for shift, reply in enumerate(replies):
        for k, byte in enumerate(reply.data):
            mixed[k] &= byte >> shift & 0xFF
    return [Reply(replies[0].ready_ns, bytes(mixed))]


def _sync_wanted(instruction: Instruction) -> Wanted | None:
    parameters = instruction.parameters
    if instruction.servo_id != protocol.BROADCAST or len(parameters) < 5:
        return None
    address, length = _pair(parameters)
    return [(servo_id, address, length) for servo_id in parameters[4:]]


def _bulk_wanted(instruction: Instruction) -> Wanted | None:
    parameters = instruction.parameters
    if instruction.servo_id != protocol.BROADCAST or not parameters or len(parameters) % 5:
        return None
    return [(parameters[k], *_pair(parameters[k + 1 : k + 5])) for k in range(0, len(parameters), 5)]


def _write_parts(instruction: Instruction) -> list[tuple[int, int, bytes]]:
    """(ID, address, data) of a sync or bulk write; what is cut off or malformed is left out."""
    parameters, parts = instruction.parameters, []
    if instruction.code == protocol.SYNC_WRITE:
        if len(parameters) < 4:
            return []
        address, length = _pair(parameters)
        step = length + 1
        for k in range(4, len(parameters) - length, step):
            parts.append((parameters[k], address, parameters[k + 1 : k + step]))
        return parts
    k = 0
    while k + 5 <= len(parameters):
        address, length = _pair(parameters[k + 1 : k + 5])
        data = parameters[k + 5 : k + 5 + length]
        if len(data) == length:
            parts.append((parameters[k], address, data))
        k += 5 + length
    return parts


_GROUP_READS: dict[int, Callable[[Instruction], Wanted | None]] = {
    protocol.SYNC_READ: _sync_wanted,
    protocol.FAST_SYNC_READ: _sync_wanted,
    protocol.BULK_READ: _bulk_wanted,
    protocol.FAST_BULK_READ: _bulk_wanted,
}
