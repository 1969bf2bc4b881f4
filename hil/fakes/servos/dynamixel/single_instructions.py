"""Instructions to one servo (or broadcast): effect, reply and error number."""

from collections.abc import Callable

from hil.fakes.servos.dynamixel import protocol
from hil.fakes.servos.dynamixel.group_instructions import pair
from hil.fakes.servos.dynamixel.protocol import Instruction
from hil.fakes.servos.dynamixel.sensed_registers import LiveRegisters
from hil.fakes.servos.dynamixel.servo import Servo

Answer = tuple[int, bytes]
"""Error number and parameters of a status packet."""

_IGNORES_TOTAL_RESET_FIRMWARE = 42
_CLEAR_TURNS = b"\x01DXL\x22"


class SingleInstructions:
    """Executes all instructions except group instructions.

    Args:
        live: function that updates the measurements before they are used.
    """

    def __init__(self, live: LiveRegisters) -> None:
        self._live = live
        self._known: dict[int, Callable[[Servo, Instruction, int], Answer | None]] = {
            protocol.PING: lambda servo, instruction, t_ns: (protocol.OK, identification(servo)),
            protocol.READ: self._read,
            protocol.WRITE: self._write,
            protocol.REG_WRITE: self._write_later,
            protocol.ACTION: self._act,
            protocol.REBOOT: lambda servo, instruction, t_ns: (protocol.OK, b""),
            protocol.CLEAR: self._clear,
            protocol.BACKUP: lambda servo, instruction, t_ns: (servo.back_up(instruction.parameters), b""),
            protocol.FACTORY_RESET: self._check_factory_reset,
        }

    def execute(self, servo: Servo, instruction: Instruction, t_ns: int) -> Answer | None:
        """Execute an instruction; None if it is ignored without a reply."""
        act = self._known.get(instruction.code)
        return (protocol.INSTRUCTION_ERROR, b"") if act is None else act(servo, instruction, t_ns)

    def finish(self, servo: Servo, instruction: Instruction, error: int, t_ns: int) -> None:
        """Complete an instruction after its reply: reboot, factory reset or restore."""
        if error != protocol.OK:
            return
        if instruction.code == protocol.REBOOT:
            self._live.sense(servo, t_ns)
            servo.reboot(t_ns)
        elif instruction.code == protocol.FACTORY_RESET:
            servo.factory_reset(instruction.parameters[0], t_ns)
        elif instruction.code == protocol.BACKUP and instruction.parameters[0] == 2:
            servo.restore(t_ns)

    def read_range(self, servo: Servo, address: int, length: int, t_ns: int) -> Answer:
        """Return the present registers of a range."""
        self._live.refresh(servo, address, length, t_ns)
        data = servo.table.read(address, length)
        return (protocol.ACCESS, b"") if data is None else (protocol.OK, data)

    def _read(self, servo: Servo, instruction: Instruction, t_ns: int) -> Answer:
        if len(instruction.parameters) != 4:
            return protocol.DATA_LENGTH, b""
        return self.read_range(servo, *pair(instruction.parameters), t_ns)

    def _write(self, servo: Servo, instruction: Instruction, t_ns: int) -> Answer:
        parameters = instruction.parameters
        if len(parameters) < 3:
            return protocol.DATA_LENGTH, b""
        self._live.sense(servo, t_ns)
        return servo.write(parameters[0] | parameters[1] << 8, parameters[2:]), b""

    def _write_later(self, servo: Servo, instruction: Instruction, t_ns: int) -> Answer:
        parameters = instruction.parameters
        if len(parameters) < 3:
            return protocol.DATA_LENGTH, b""
        return servo.register_write(parameters[0] | parameters[1] << 8, parameters[2:]), b""

    def _act(self, servo: Servo, instruction: Instruction, t_ns: int) -> Answer:
        self._live.sense(servo, t_ns)
        return servo.act(), b""

    def _clear(self, servo: Servo, instruction: Instruction, t_ns: int) -> Answer:
        if instruction.parameters != _CLEAR_TURNS:
            return protocol.DATA_RANGE, b""
        self._live.sense(servo, t_ns)
        return servo.clear_turns(), b""

    @staticmethod
    def _check_factory_reset(servo: Servo, instruction: Instruction, t_ns: int) -> Answer | None:
        if len(instruction.parameters) != 1 or instruction.parameters[0] not in (0xFF, 1, 2):
            return protocol.DATA_RANGE, b""
        everything = instruction.parameters[0] == 0xFF
        for_all = instruction.servo_id == protocol.BROADCAST
        if everything and for_all and servo.firmware >= _IGNORES_TOTAL_RESET_FIRMWARE:
            return None
        return protocol.OK, b""


def identification(servo: Servo) -> bytes:
    """Return the parameters of a ping's reply: model number and firmware."""
    return servo.table.get("model_number").to_bytes(2, "little") + bytes((servo.firmware,))
