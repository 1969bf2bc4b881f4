"""A servo's control table as memory: access rights, ranges, the EEPROM lock, indirect addresses.

Reads and writes use byte ranges as on the wire; a write is split into whole registers, with indirect data
resolved to their targets. The servo implements side effects.
"""

import struct
from functools import cache

from hil.config.servo_models import Register, ServoModel
from hil.fakes.servos.dynamixel import protocol

GOALS = ("goal_pwm", "goal_current", "goal_velocity", "goal_position")
_MEASURED = (
    "realtime_tick",
    "moving",
    "moving_status",
    "present_pwm",
    "present_current",
    "present_velocity",
    "present_position",
    "velocity_trajectory",
    "position_trajectory",
    "present_input_voltage",
    "present_temperature",
)
_MOTION = ("present_current", "present_velocity", "present_position")
_CODES = {1: "b", 2: "h", 4: "i"}
_NOT_BACKED_UP = ("id", "baud_rate", "torque_enable", "bus_watchdog", *GOALS)

Plan = tuple[tuple[Register, int], ...]


class WriteRefused(Exception):
    """The servo rejects a write; `code` is the error number of its status packet."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class RegisterRow:
    """Consecutive registers that are written together.

    Attributes:
        address, end: address of the first byte, and of the byte after the last.
        pack: function that packs one value per register.
    """

    def __init__(self, model: ServoModel, names: tuple[str, ...]) -> None:
        registers = [model.table[name] for name in names]
        self.address, self.end = registers[0].address, registers[-1].end
        layout = struct.Struct("<" + "".join(map(_code, registers)))
        assert layout.size == self.end - self.address
        self.pack = layout.pack


def _code(register: Register) -> str:
    code = _CODES[register.size]
    return code if register.signed else code.upper()


class Layout:
    """Data derived from a model's control table, computed once.

    Attributes:
        factory: bytes after a factory reset.
        by_address: register by its start address.
        unpack: struct and address of each register, by name.
        indirect: address of the pointer, by the address of the indirect data byte.
        first_indirect: first address at which a read must resolve indirect data.
        measured, motion: the live registers, and those of them that are read in every cycle.
    """

    def __init__(self, model: ServoModel) -> None:
        table = model.table
        factory = bytearray(model.table_size)
        for register in table.values():
            factory[register.address : register.end] = register.encode(register.default)
        self.factory = bytes(factory)
        self.by_address = {r.address: r for r in table.values()}
        self.unpack = {r.name: (struct.Struct("<" + _code(r)), r.address) for r in table.values()}
        self.indirect = {
            r.address: table[name.replace("_data_", "_address_")].address
            for name, r in table.items()
            if name.startswith("indirect_data_")
        }
        self.first_indirect = min(self.indirect)
        self.measured, self.motion = RegisterRow(model, _MEASURED), RegisterRow(model, _MOTION)


@cache
def layout(model: ServoModel) -> Layout:
    """Return the cached layout of a model's table."""
    return Layout(model)


class ControlTable:
    """Bytes of a servo's control table, with access rules.

    Args:
        model: model of the servo.

    Attributes:
        model: model of the servo.
        layout: layout of the table.
        data: raw bytes; live registers are updated before they are read.
    """

    def __init__(self, model: ServoModel) -> None:
        self.model, self.layout = model, layout(model)
        self.data = bytearray(self.layout.factory)
        self._registers, self._unpack = model.table, self.layout.unpack
        self._plans: dict[tuple[int, int], Plan] = {}
        self._looks: dict[tuple[int, int], list[int]] = {}

    def get(self, name: str) -> int:
        """Return the raw count of a register."""
        form, address = self._unpack[name]
        raw: int = form.unpack_from(self.data, address)[0]
        return raw

    def put_row(self, row: RegisterRow, data: bytes) -> None:
        """Write consecutive registers without any check."""
        self.data[row.address : row.end] = data

    def put(self, name: str, raw: int) -> None:
        """Write a register without any check."""
        register = self._registers[name]
        self.data[register.address : register.end] = register.encode(raw)
        if name.startswith("indirect_address"):
            self._forget()

    def read(self, address: int, length: int) -> bytes | None:
        """Return the bytes of a range with indirect data resolved; None beyond the table."""
        end = address + length
        if length == 0 or end > len(self.data):
            return None
        if end <= self.layout.first_indirect:
            return bytes(self.data[address:end])
        key = (address, length)
        look = self._looks.get(key)
        if look is None:
            look = self._looks[key] = [self._resolve(a) for a in range(address, end)]
        return bytes(map(self.data.__getitem__, look))

    def plan(self, address: int, length: int) -> Plan:
        """Return the registers that a write to this range covers, with their offsets into the data.

        Raises:
            WriteRefused: a register is undefined, only partly covered, or not in this firmware.
        """
        key = (address, length)
        plan = self._plans.get(key)
        if plan is None:
            plan = self._plans[key] = self._split(address, length)
        return plan

    def check(self, register: Register, raw: int, torque: bool) -> None:
        """Raise `WriteRefused` if a register cannot have this value now."""
        if not register.writable:
            raise WriteRefused(protocol.ACCESS)
        if torque and (register.eeprom or register.name.startswith("indirect_address")):
            raise WriteRefused(protocol.ACCESS)
        if not register.permits(raw):
            raise WriteRefused(protocol.DATA_RANGE)
        if register.limit and abs(raw) > self.get(register.limit):
            raise WriteRefused(protocol.DATA_LIMIT)

    def reset_ram(self) -> None:
        """Reset the RAM registers to their values after power-up."""
        first = self._registers["torque_enable"].address
        self.data[first:] = self.layout.factory[first:]
        self.put("goal_pwm", self.get("pwm_limit"))
        self.put("goal_current", self.get("current_limit"))
        self._forget()

    def _forget(self) -> None:
        """Clear the caches, because indirect addresses have changed."""
        self._plans.clear()
        self._looks.clear()

    def snapshot(self) -> dict[str, int]:
        """Return the registers that a control table backup stores."""
        return {
            name: self.get(name)
            for name, register in self._registers.items()
            if register.writable and name not in _NOT_BACKED_UP
        }

    def restore(self, snapshot: dict[str, int], *, eeprom: bool) -> None:
        """Restore the RAM registers of a backup, and the EEPROM registers with `eeprom`."""
        for name, raw in snapshot.items():
            if eeprom or not self._registers[name].eeprom:
                self.put(name, raw)

    def _resolve(self, address: int) -> int:
        pointer = self.layout.indirect.get(address)
        return address if pointer is None else self.data[pointer] | self.data[pointer + 1] << 8

    def _split(self, address: int, length: int) -> Plan:
        if length == 0:
            raise WriteRefused(protocol.DATA_LENGTH)
        if address + length > len(self.data):
            raise WriteRefused(protocol.ACCESS)
        targets = [self._resolve(a) for a in range(address, address + length)]
        plan, k, firmware = [], 0, self.get("firmware_version")
        while k < length:
            register = self.layout.by_address.get(targets[k])
            if register is None or register.firmware > firmware:
                raise WriteRefused(protocol.ACCESS)
            if targets[k : k + register.size] != list(range(register.address, register.end)):
                raise WriteRefused(protocol.DATA_LENGTH)
            plan.append((register, k))
            k += register.size
        return tuple(plan)
