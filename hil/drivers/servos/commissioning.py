"""Finding servos at any baud rate, and setting one up: the only place that writes the EEPROM."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from hil.config.xh430 import BAUD_CODES, BAUD_RATES, TABLE, Register
from hil.drivers.servos import packets
from hil.drivers.servos import registers as reg
from hil.drivers.servos.bus import Bus
from hil.drivers.servos.packets import find_statuses
from hil.drivers.servos.port import ServoPort
from hil.vocabulary.clock import Clock
from hil.vocabulary.errors import DeviceError, UsageError
from hil.vocabulary.signals import Status

_DEVICE = "servos"
_LATENCY_S, _SLACK_S = 0.016, 0.004  # an adapter as delivered must do here
_PING_SLOT_S = 0.003
_STATUS_BYTES = 14
_LAST = ("id", "baud_rate")
_ALL_IDS = tuple(range(253))
_USUAL = (1_000_000, 57_600, 3_000_000, 4_500_000, 2_000_000, 4_000_000, 115_200, 9_600)


@dataclass(frozen=True)
class FoundServo:
    """A servo that answered a scan; `operating_mode` is -1 where it could not be read."""

    servo_id: int
    baud: int
    model: int
    firmware: int
    operating_mode: int = -1
    return_delay_s: float = 0.0


def scan(
    port: str,
    clock: Clock,
    *,
    bauds: Iterable[int] = _USUAL,
    ids: Iterable[int] = _ALL_IDS,
) -> tuple[FoundServo, ...]:
    """Servos at a port, by one broadcast ping per baud rate (about 3 ms per ID asked for).

    Raises:
        DeviceError: the port cannot be opened.
    """
    wanted, rates = set(ids), [_checked_baud(b) for b in bauds]
    found: dict[tuple[int, int], FoundServo] = {}
    line = ServoPort(port, rates[0], clock, latency_s=_LATENCY_S, slack_s=_SLACK_S)
    line.open(_DEVICE)
    bus = Bus(line, clock, _DEVICE)
    try:
        for baud in rates:
            bus.set_baud(baud)
            for servo in _roll_call(bus, wanted, baud):
                found[servo.baud, servo.servo_id] = servo
    finally:
        bus.close()
    return tuple(found[key] for key in sorted(found))


def _checked_baud(baud: int) -> int:
    if baud not in BAUD_CODES:
        raise UsageError(
            f"baud rate {baud} is not one of the servo's",
            expected=", ".join(str(b) for b in BAUD_RATES.values()),
        )
    return baud


def _roll_call(bus: Bus, wanted: set[int], baud: int) -> list[FoundServo]:
    if not wanted or not bus.send(packets.ping_all()):
        return []
    duration_s = _PING_SLOT_S * (max(wanted) + 1) + bus.port.reply_s(10, _STATUS_BYTES * len(wanted))
    data = bus.gather(duration_s, _STATUS_BYTES * 253 * 2)
    servos = []
    for servo_id, answer in find_statuses(data):
        if servo_id in wanted and answer.status is Status.OK and len(answer.data) == 3:
            model, firmware = answer.data[0] | answer.data[1] << 8, answer.data[2]
            delay, _, mode = bus.read(servo_id, TABLE["return_delay_time"].address, 3).data or (0, 0, -1)
            servos.append(FoundServo(servo_id, baud, model, firmware, mode, delay * 2e-6))
    return servos


def set_up(
    port: str,
    clock: Clock,
    *,
    baud: int,
    servo_id: int,
    new_id: int | None = None,
    new_baud: int | None = None,
    registers: Mapping[str, int] | None = None,
) -> dict[str, tuple[int, int]]:
    """Write the EEPROM of one servo, register by register, each read back; never with torque on.

    Args:
        port: pyserial URL or device path.
        clock: the bench clock.
        baud: at which the servo listens now.
        servo_id: which it has now.
        new_id: which it shall have; written after the registers.
        new_baud: at which it shall listen; written last.
        registers: further EEPROM registers by name, raw counts.

    Returns:
        (before, after) by name of every register that was asked for.

    Raises:
        UsageError: an unknown register or a value outside its range; nothing has been written.
        DeviceError: no servo, torque on, the new ID taken, or a value that did not stay.
    """
    wanted = dict(registers or {})
    if new_id is not None:
        wanted["id"] = new_id
    if new_baud is not None:
        wanted["baud_rate"] = BAUD_CODES[_checked_baud(new_baud)]
    _check_registers(wanted)
    line = ServoPort(port, _checked_baud(baud), clock, latency_s=_LATENCY_S, slack_s=_SLACK_S)
    line.open(_DEVICE)
    bus = Bus(line, clock, _DEVICE)
    try:
        return _write_eeprom(bus, servo_id, wanted)
    finally:
        bus.close()


def _check_registers(wanted: Mapping[str, int]) -> None:
    for name, raw in wanted.items():
        register = TABLE.get(name)
        if register is None or not register.eeprom or not register.writable:
            known = ", ".join(r.name for r in TABLE.values() if r.eeprom and r.writable)
            raise UsageError(f"{name} is not a register that can be set up", expected="one of " + known)
        if not register.permits(raw):
            raise UsageError(f"{name} = {raw}", expected=register.range_text())


def _write_eeprom(bus: Bus, servo_id: int, wanted: Mapping[str, int]) -> dict[str, tuple[int, int]]:
    found = bus.read(servo_id, 0, reg.TORQUE + 1)
    if found.status is not Status.OK:
        raise bus.failure(found, f"servo {servo_id} cannot be read")
    if found.data[reg.TORQUE]:
        raise DeviceError(
            _DEVICE,
            f"servo {servo_id} has torque on",
            port=bus.port.port_name,
            expected="torque off: the EEPROM is locked and the robot may hang on it",
            remedy="secure the robot, release torque, then repeat",
        )
    new_id = wanted.get("id", servo_id)
    if new_id != servo_id and bus.ping(new_id).status is not Status.TIMEOUT:
        raise DeviceError(
            _DEVICE,
            f"ID {new_id} is taken",
            port=bus.port.port_name,
            expected="a free ID",
            remedy="connect one servo at a time, or choose another ID",
        )
    changes = {name: (reg.from_block(found.data, name), raw) for name, raw in wanted.items()}
    for name in sorted(wanted, key=lambda n: (_LAST.index(n) + 1) if n in _LAST else 0):
        before, raw = changes[name]
        if before == raw:
            continue
        register = TABLE[name]
        if name in _LAST:
            _rename(bus, servo_id, register, raw)
            servo_id = raw if name == "id" else servo_id
        else:
            bus.demand(servo_id, register.address, register.encode(raw), name)
        check = bus.read(servo_id, register.address, register.size)
        if check.status is not Status.OK or register.decode(check.data) != raw:
            raise bus.failure(check, f"servo {servo_id}: {name} = {raw} did not stay")
    return changes


def _rename(bus: Bus, servo_id: int, register: Register, raw: int) -> None:
    """Write ID or baud rate. Firmware may acknowledge as old or as new, so silence proves nothing here."""
    answer = bus.write(servo_id, register.address, register.encode(raw))
    if answer.status not in (Status.OK, Status.TIMEOUT):
        raise bus.failure(answer, f"servo {servo_id}: {register.name} cannot be written")
    if register.name == "baud_rate":
        bus.set_baud(BAUD_RATES[raw])
