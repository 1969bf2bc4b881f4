"""Eight emulated servos on one half-duplex bus: addressing and the order of replies.

This module has timing and addressing; `servo.py` and `single_instructions.py` have the servos. The bus ticks
every 4 ms for measurement grid, profiles and bus watchdogs, and every 0.1 s for temperature, voltage and
overload.
"""

from __future__ import annotations

from hil.config.servo_models import DEFAULT_MODEL
from hil.config.servo_models.x_series_codes import WATCHDOG_STEP_S
from hil.core.clock import nanoseconds
from hil.fakes.emulation_request import EmulationRequest
from hil.fakes.serial_chip import Reply, SerialChip
from hil.fakes.servos.dynamixel import protocol
from hil.fakes.servos.dynamixel.angle_errors import AngleErrors
from hil.fakes.servos.dynamixel.faults import BUS_FAULTS, ServoFaults
from hil.fakes.servos.dynamixel.group_instructions import GROUP_READS, Wanted, write_parts
from hil.fakes.servos.dynamixel.protocol import Instruction, InstructionParser
from hil.fakes.servos.dynamixel.sensed_registers import Cadence, LiveRegisters
from hil.fakes.servos.dynamixel.sensing import GRID_NS, Sensing
from hil.fakes.servos.dynamixel.servo import Servo
from hil.fakes.servos.dynamixel.single_instructions import SingleInstructions, identification
from hil.fakes.servos.dynamixel.thermal_load import ThermalModel
from hil.fakes.servos.dynamixel.true_parameters import ServoBusOptions
from hil.fakes.world import Scheduled, World

_SLOW_TICKS = 25
_WATCHDOG_STEP_NS = nanoseconds(WATCHDOG_STEP_S)
_BAUD_TOLERANCE = 0.03
_FAST = (protocol.FAST_SYNC_READ, protocol.FAST_BULK_READ)


class _Listening:
    """The servos that listen, in their order, until one of them changes.

    Attributes:
        servos: servos that listen.
        able, able_by_id: those of them that take part in fast reads.
    """

    def __init__(self, servos: list[Servo]) -> None:
        self.servos = servos
        self.able = [servo for servo in servos if servo.reads_fast]
        self.able_by_id = {servo.id: servo for servo in self.able}
        ids = {one for servo in servos for one in (servo.id, servo.secondary)}
        self._by_id = {one: self.addressed(one, changed=True) for one in ids}

    def addressed(self, servo_id: int, *, changed: bool) -> list[Servo]:
        """Servos to which a group write to an ID goes; `changed`: IDs may have changed meanwhile."""
        if changed:
            return [servo for servo in self.servos if servo_id in (servo.id, servo.secondary)]
        return self._by_id.get(servo_id, [])


class ServoBus(SerialChip, Scheduled):
    """Serial bus with eight servos, ordered as in `hil.core.signals.SERVOS`.

    Args:
        world: plant, seed and faults; the bus registers itself there.
        name: device name of its faults.
        options: settings and supply of the servos.
    """

    Options = ServoBusOptions
    alone = True
    announces = True
    polls_alone = True

    @classmethod
    def build(cls, request: EmulationRequest) -> ServoBus:
        """Make the bus from its table of the bench file; the options may differ from it."""
        config = request.config
        model = config.model_number or DEFAULT_MODEL
        options = request.options(cls.Options, ids=config.ids, baud=config.baud, model_number=model)
        return cls(request.world, options=options)

    def __init__(self, world: World, name: str = "servos", options: ServoBusOptions | None = None) -> None:
        self.name = name
        self.supported_faults = BUS_FAULTS
        self.options = options = options if options is not None else ServoBusOptions()
        self._world = world
        rng = world.rng(name)
        models = options.models()
        self._faults = ServoFaults(world.faults, name, options.ids, rng, models)
        errors = None
        if AngleErrors.given(options):
            errors = AngleErrors(options, models, world.rng(f"{name} angles"), GRID_NS * 1e-9)
        of_angle = options.velocity_from == "angle"
        self._sensing = Sensing(world.plant, rng, models, options.dither_counts, errors, of_angle=of_angle)
        self._thermal = ThermalModel(self._sensing, options, models)
        self._live = LiveRegisters(self._sensing, self._thermal, self._faults)
        self._single = SingleInstructions(self._live)
        self.servos = tuple(Servo(j, world.plant, options, model) for j, model in enumerate(models))
        self._axes = [servo.axis for servo in self.servos]
        encoder = self._sensing.counts()
        self._bus: _Listening | None = None
        for servo in self.servos:
            servo.boot(0, encoder[servo.joint])
            servo.busy_until_ns = 0
            servo.on_change = self._forget
        self._parser = InstructionParser()
        self._baud = 0
        self._processing_ns = round(options.processing_s * 1e9)
        self._due_ns = GRID_NS
        self._traffic_ns = 0
        world.add(self)
        if options.cadence_s > 0.0:
            world.add(Cadence(options, rng, self._live.hold))

    def next_due_ns(self) -> int:
        """Next point of the measurement grid."""
        return self._due_ns

    def on_due(self, t_ns: int) -> None:
        """Handle one tick of the grid."""
        self._due_ns = t_ns + GRID_NS
        self._sensing.tick()
        if not self._faults.plan.empty:
            self._follow_faults(t_ns)
        for axis in self._axes:
            if axis.trajectory.ongoing:
                axis.advance(GRID_NS * 1e-9)
        silence_ns = t_ns - self._traffic_ns
        if silence_ns >= _WATCHDOG_STEP_NS:
            self._watch(t_ns, silence_ns)
        if self._sensing.ticks % _SLOW_TICKS == 0:
            self._thermal.step(self.servos, _SLOW_TICKS * GRID_NS * 1e-9)

    def reset(self, t_ns: int) -> None:
        """Reset everything, as a power cycle does."""
        self._parser.reset()
        encoder = self._sensing.counts()
        for servo in self.servos:
            servo.dead = False
            servo.boot(t_ns, encoder[servo.joint])

    def receive(self, data: bytes, t_ns: int, baud: int) -> list[Reply]:
        """Answer instruction packets; servos with another baud rate do not receive them."""
        if not self._faults.plan.empty:
            self._follow_faults(t_ns)
        if baud != self._baud:
            self._parser.reset()
            self._baud = baud
            self._forget()
        first_ns = t_ns - (len(data) - 1) * 10_000_000_000 // baud if data else t_ns
        instructions = self._parser.feed(data, first_ns, t_ns)
        return [
            reply._replace(goes_on=True) if number else reply
            for instruction in instructions
            for number, reply in enumerate(self._execute(instruction, t_ns))
        ]

    def _forget(self) -> None:
        """Servos may listen or answer otherwise from now on."""
        self._bus = None

    def _listening(self, t_ns: int) -> _Listening:
        """Servos that receive data now: connected, powered, booted and at the client's baud rate."""
        if self._bus is not None:
            return self._bus
        baud, absent = self._baud, self.options.absent
        found = _Listening(
            [
                s
                for s in self.servos
                if not s.dead
                and t_ns >= s.busy_until_ns
                and abs(baud - s.baud) <= _BAUD_TOLERANCE * s.baud
                and s.id not in absent
            ]
        )
        if all(t_ns >= s.busy_until_ns for s in self.servos):
            self._bus = found
        return found

    def _execute(self, instruction: Instruction, t_ns: int) -> list[Reply]:
        listening = self._listening(t_ns)
        listeners = listening.servos
        if not instruction.sound:
            return [
                r
                for s in listeners
                if s.id == instruction.servo_id
                for r in self._status(s, protocol.CRC_ERROR, b"", t_ns)
            ]
        if listeners:
            self._traffic_ns = t_ns
        if instruction.code in GROUP_READS:
            wanted = GROUP_READS[instruction.code](instruction)
            if instruction.code not in _FAST:
                return self._read_in_turn(wanted, listeners, t_ns)
            return self._fast_read(wanted, listening, t_ns)
        if instruction.code in (protocol.SYNC_WRITE, protocol.BULK_WRITE):
            self._write_group(instruction, listening, t_ns)
            return []
        if instruction.code == protocol.PING and instruction.servo_id == protocol.BROADCAST:
            return self._roll_call(listeners, t_ns)
        return self._obey(instruction, listeners, t_ns)

    def _obey(self, instruction: Instruction, listeners: list[Servo], t_ns: int) -> list[Reply]:
        """Execute a single instruction; a servo addressed by its secondary ID does not answer."""
        level = {protocol.PING: 0, protocol.READ: 1}.get(instruction.code, 2)
        replies = []
        for servo in [s for s in listeners if s.answers_to(instruction.servo_id)]:
            addressed_id = servo.id
            answer = self._single.execute(servo, instruction, t_ns)
            if answer is None:
                continue
            if instruction.servo_id == addressed_id and servo.answers(level):
                replies += self._status(servo, *answer, t_ns, servo_id=addressed_id)
            self._single.finish(servo, instruction, answer[0], t_ns)
        return _collided(replies)

    def _status(
        self, servo: Servo, error: int, parameters: bytes, t_ns: int, servo_id: int | None = None
    ) -> list[Reply]:
        """Build a status packet; its ID is `servo_id` if the instruction has changed the servo's ID."""
        sender = servo.id if servo_id is None else servo_id
        data = protocol.status(sender, error | servo.alert, parameters)
        ready_ns = t_ns + self._processing_ns + servo.delay_ns
        if self._faults.plan.empty:
            return [Reply(ready_ns, data)]
        late_ns = self._faults.late_ns(servo.joint, t_ns)
        heard = self._faults.replies[servo.joint].received(data, t_ns)
        return [Reply(ready_ns + late_ns, one) for one in heard]

    def _roll_call(self, listeners: list[Servo], t_ns: int) -> list[Reply]:
        slot_ns = round(self.options.ping_slot_s * 1e9)
        replies: list[Reply] = []
        for servo in sorted(listeners, key=lambda s: s.id):
            mine = self._status(servo, protocol.OK, identification(servo), t_ns + servo.id * slot_ns)
            if replies and mine and mine[0].ready_ns == replies[-1].ready_ns:
                mine = _collided([replies.pop(), *mine])
            replies += mine
        return replies

    def _write_group(self, instruction: Instruction, listening: _Listening, t_ns: int) -> None:
        """Execute a sync or bulk write: no replies; a servo rejects invalid data silently."""
        for servo in listening.servos:
            if not servo.axis.torque:
                self._live.sense(servo, t_ns)
        for servo_id, address, data in write_parts(instruction):
            for servo in listening.addressed(servo_id, changed=self._bus is not listening):
                if not servo.repeats(address, data):
                    servo.write(address, data)

    def _read_in_turn(self, wanted: Wanted, listeners: list[Servo], t_ns: int) -> list[Reply]:
        """Execute a sync or bulk read: each servo replies when the one before it has finished."""
        byte_ns = 10_000_000_000 // self._baud
        replies: list[Reply] = []
        free_ns = t_ns
        for servo_id, address, length in wanted:
            mine: list[Reply] = []
            for servo in listeners:
                if servo.id == servo_id and servo.answers(level=1):
                    error, data = self._single.read_range(servo, address, length, t_ns)
                    mine += self._status(servo, error, data, free_ns)
            if not mine:
                if self.options.after_absent == "silent":
                    break
                free_ns += self._processing_ns + (length + 11) * byte_ns
                continue
            for reply in _collided(mine):
                replies.append(reply)
                free_ns = reply.ready_ns + len(reply.data) * byte_ns
        return replies

    def _fast_read(self, wanted: Wanted, listening: _Listening, t_ns: int) -> list[Reply]:
        """Execute a fast sync or bulk read: one packet that the servos send together."""
        able, by_id = listening.able, listening.able_by_id
        if not self._faults.plan.empty:
            able = [s for s in able if self._faults.replies[s.joint].copies(t_ns)]
            by_id = {s.id: s for s in able}
        places = []
        for place, (servo_id, _, _) in enumerate(wanted):
            servo = by_id.get(servo_id)
            if servo is not None:
                places.append((place, servo))
            elif self.options.after_absent == "silent":
                break
        if not places:
            return []
        parts = self._parts(wanted, places, t_ns)
        declared = 1 + sum(length + 4 for _, _, length in wanted)
        pieces = protocol.fast_status(parts, declared)
        if places[0][0]:
            pieces[0] = pieces[0][8:]
        ready_ns = t_ns + self._processing_ns + max(s.delay_ns for _, s in places)
        if len(by_id) < len(able):
            ids = [s.id for s in able]
            pieces = [
                protocol.mixed((piece, piece)) if ids.count(servo.id) > 1 else piece
                for piece, (_, servo) in zip(pieces, places, strict=True)
            ]
        if len(pieces) == len(wanted) and self._faults.plan.empty:
            return [Reply(ready_ns, b"".join(pieces))]
        return self._spaced(pieces, places, wanted, ready_ns, t_ns)

    def _parts(
        self, wanted: Wanted, places: list[tuple[int, Servo]], t_ns: int
    ) -> list[tuple[int, int, bytes]]:
        """ID, error and data of each servo that takes part in a fast read."""
        _, address, length = wanted[0]
        if all(part[1] == address and part[2] == length for part in wanted):
            motion = self._live.motion([servo for _, servo in places], address, length, t_ns)
            if motion is not None:
                return [
                    (servo.id, servo.alert, data) for (_, servo), data in zip(places, motion, strict=True)
                ]
        parts = []
        for place, servo in places:
            servo_id, address, length = wanted[place]
            error, data = self._single.read_range(servo, address, length, t_ns)
            parts.append((servo_id, error | servo.alert, data if data else bytes(length)))
        return parts

    def _spaced(
        self, pieces: list[bytes], places: list[tuple[int, Servo]], wanted: Wanted, ready_ns: int, t_ns: int
    ) -> list[Reply]:
        """Parts of a fast reply, with gaps for servos that are missing or late, each with its faults."""
        byte_ns = 10_000_000_000 // self._baud
        replies: list[Reply] = []
        next_place = 0
        for piece, (place, servo) in zip(pieces, places, strict=True):
            gap_ns = sum((wanted[k][2] + 4) * byte_ns for k in range(next_place, place))
            gap_ns += self._faults.late_ns(servo.joint, t_ns)
            ready_ns += gap_ns
            data = self._faults.replies[servo.joint].damaged(piece, t_ns)
            if replies and not gap_ns:
                replies[-1] = replies[-1]._replace(data=replies[-1].data + data)
            else:
                replies.append(Reply(ready_ns, data))
            ready_ns += len(piece) * byte_ns
            next_place = place + 1
        return replies

    def _follow_faults(self, t_ns: int) -> None:
        """Apply faults of power, resets and slips; faults of replies are applied per packet."""
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
            self._slide(servo, t_ns)

    def _slide(self, servo: Servo, t_ns: int) -> None:
        """Let the motor turn further than its joint while the hub slips."""
        j = servo.joint
        share = self._faults.share(j, t_ns)
        if share < 1.0:
            servo.slip(self._faults.slid_counts(j, share, self._sensing.counts()[j]))
        if share != servo.axis.share:
            servo.axis.share = share
            servo.axis.drive()

    def _watch(self, t_ns: int, silence_ns: int) -> None:
        for servo in self.servos:
            limit_ns = servo.watchdog_ns()
            if limit_ns and silence_ns > limit_ns:
                self._live.sense(servo, t_ns)
                servo.trip()


def _collided(replies: list[Reply]) -> list[Reply]:
    """Combine the replies of servos with the same ID: the result is not a valid packet."""
    if len(replies) < 2:
        return replies
    return [Reply(replies[0].ready_ns, protocol.mixed([r.data for r in replies]))]
