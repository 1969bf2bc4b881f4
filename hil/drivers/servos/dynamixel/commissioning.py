"""Finds servos at any baud rate, and sets one up: the only place that writes the EEPROM."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from hil.config.servo_models import (
    Register,
    ServoModel,
    model_text,
    models_text,
    servo_models,
    shared_register,
)
from hil.config.servo_models.x_series_codes import BAUD_CODES, BAUD_RATES, RETURN_DELAY_STEP_S
from hil.core.clock import Clock
from hil.core.errors import DeviceError, UsageError
from hil.core.signals import Status
from hil.drivers.servos.dynamixel import packets
from hil.drivers.servos.dynamixel.bus import Bus
from hil.drivers.servos.dynamixel.packets import find_statuses
from hil.drivers.servos.dynamixel.register_map import from_block
from hil.drivers.servos.dynamixel.sdk_port import ServoPort
from hil.links.serial_over_tcp import SOCKET

_DEVICE = "servos"
_LATENCY_S, _SLACK_S = 0.016, 0.05  # enough for an adapter with default settings on a busy computer
_PING_SLOT_S = 0.003
_STATUS_BYTES = 14
_LAST = ("id", "baud_rate")
_ALL_IDS = tuple(range(253))
_USUAL = (1_000_000, 57_600, 3_000_000, 4_500_000, 2_000_000, 4_000_000, 115_200, 9_600)


@dataclass(frozen=True)
class FoundServo:
    """A servo that answered a scan.

    Attributes:
        servo_id, baud: ID and baud rate at which it answers.
        model, firmware: model number and firmware that it reports.
        operating_mode: operating mode; -1 where it could not be read: no answer, or a model without a control
            table.
        return_delay_s: return delay; 0 where it could not be read.
    """

    servo_id: int
    baud: int
    model: int
    firmware: int
    operating_mode: int = -1
    return_delay_s: float = 0.0


def scan(
    port: str, clock: Clock, *, bauds: Iterable[int] = _USUAL, ids: Iterable[int] = _ALL_IDS
) -> tuple[FoundServo, ...]:
    """Servos at a port, by one broadcast ping per baud rate (about 3 ms per ID).

    The server of a raw socket sets the baud rate, so there only the first of the rates is asked.

    Raises:
        DeviceError: the port cannot be opened.
    """
    wanted, rates = set(ids), [_checked_baud(b) for b in bauds]
    if port.lower().startswith(SOCKET):
        rates = rates[:1]
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
            mode, delay = _mode_and_delay(bus, servo_id, servo_models().get(model))
            servos.append(FoundServo(servo_id, baud, model, firmware, mode, delay * RETURN_DELAY_STEP_S))
    return servos


def _mode_and_delay(bus: Bus, servo_id: int, model: ServoModel | None) -> tuple[int, int]:
    """Operating mode and raw return delay, read in one go; (-1, 0) where they are not known."""
    if model is None:
        return -1, 0
    delay, mode = model.table["return_delay_time"], model.table["operating_mode"]
    data = bus.read(servo_id, delay.address, mode.end - delay.address).data
    if not data:
        return -1, 0
    return mode.decode(data[mode.address - delay.address :]), delay.decode(data)


def set_up(
    port: str,
    clock: Clock,
    *,
    baud: int,
    servo_id: int,
    new_id: int | None = None,
    new_baud: int | None = None,
    registers: Mapping[str, int] | None = None,
    dry_run: bool = False,
) -> dict[str, tuple[int, int]]:
    """Write the EEPROM of one servo, register by register, each read back; never with torque on.

    The control table of the model that answers decides which registers and values there are.

    Args:
        port: pyserial URL or device path.
        clock: the bench clock.
        baud: present baud rate of the servo.
        servo_id: its present ID.
        new_id: its new ID; written after the registers.
        new_baud: its new baud rate; written last.
        registers: further EEPROM registers by name, raw counts.
        dry_run: True to read and check only; nothing is written.

    Returns:
        (before, after) by name of every register that was to be written.

    Raises:
        UsageError: an unknown register, one that the servo's firmware lacks or a value outside its range;
            nothing has been written.
        DeviceError: no servo, a model without a control table, torque on, the new ID taken, or a value that
            did not stay.
    """
    wanted = dict(registers or {})
    if new_id is not None:
        wanted["id"] = new_id
    if new_baud is not None:
        wanted["baud_rate"] = BAUD_CODES[_checked_baud(new_baud)]
    _check_for_any_model(wanted)
    line = ServoPort(port, _checked_baud(baud), clock, latency_s=_LATENCY_S, slack_s=_SLACK_S)
    line.open(_DEVICE)
    bus = Bus(line, clock, _DEVICE)
    try:
        table, changes = _changes(bus, servo_id, wanted)
        if not dry_run:
            _write_eeprom(bus, servo_id, table, changes)
        return changes
    finally:
        bus.close()


def _check_for_any_model(wanted: Mapping[str, int]) -> None:
    """Refuse what no model takes, before anything is opened."""
    refusals = [_refusal(model, wanted) for model in servo_models().values()]
    if refusals[0] is not None and None not in refusals:
        raise refusals[0]


def _refusal(model: ServoModel, wanted: Mapping[str, int], firmware: int | None = None) -> UsageError | None:
    """Why a model refuses the wanted values, None where it takes them; `firmware` once it is known."""
    found = "" if firmware is None else f" for {model.name}"
    for name, raw in wanted.items():
        register = model.table.get(name)
        if register is None or not register.eeprom or not register.writable:
            known = ", ".join(r.name for r in model.table.values() if r.eeprom and r.writable)
            return UsageError(f"{name} is not a register that can be set up", expected="one of " + known)
        if not register.permits(raw):
            return UsageError(f"{name} = {raw}", expected=register.range_text() + found)
        if firmware is not None and firmware < register.firmware:
            return UsageError(
                f"{name}: the servo has firmware {firmware}",
                expected=f"firmware {register.firmware} or later",
                remedy="update the firmware with DYNAMIXEL Wizard",
            )
    return None


def _model_of(servo_id: int, block: bytes, port: str) -> ServoModel:
    """The model by a servo's first registers."""
    number = from_block(block, shared_register("model_number"))
    model = servo_models().get(number)
    if model is None:
        raise DeviceError(
            _DEVICE,
            f"servo {servo_id} is of model {model_text(number)}, which has no control table here",
            port=port,
            expected=models_text(),
            remedy="set it up with DYNAMIXEL Wizard, or exchange it",
        )
    return model


def _changes(
    bus: Bus, servo_id: int, wanted: Mapping[str, int]
) -> tuple[Mapping[str, Register], dict[str, tuple[int, int]]]:
    """Control table of a servo that may be set up, and what would change."""
    torque = shared_register("torque_enable")
    found = bus.read(servo_id, 0, torque.end)
    if found.status is not Status.OK:
        raise bus.failure(found, f"servo {servo_id} cannot be read")
    model = _model_of(servo_id, found.data, bus.port.port_name)
    table = model.table
    refusal = _refusal(model, wanted, from_block(found.data, table["firmware_version"]))
    if refusal is not None:
        raise refusal
    if from_block(found.data, torque):
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
    return table, {name: (from_block(found.data, table[name]), raw) for name, raw in wanted.items()}


def _write_eeprom(
    bus: Bus, servo_id: int, table: Mapping[str, Register], changes: Mapping[str, tuple[int, int]]
) -> None:
    for name in sorted(changes, key=lambda n: (_LAST.index(n) + 1) if n in _LAST else 0):
        before, raw = changes[name]
        if before == raw:
            continue
        register = table[name]
        if name in _LAST:
            _rename(bus, servo_id, register, raw)
            servo_id = raw if name == "id" else servo_id
        else:
            bus.demand(servo_id, register.address, register.encode(raw), name)
        check = bus.read(servo_id, register.address, register.size)
        if check.status is not Status.OK or register.decode(check.data) != raw:
            raise bus.failure(check, f"servo {servo_id}: {name} = {raw} did not stay")


def _rename(bus: Bus, servo_id: int, register: Register, raw: int) -> None:
    """Write ID or baud rate. Firmware may acknowledge with the old or the new one: silence is no failure."""
    answer = bus.write(servo_id, register.address, register.encode(raw))
    if answer.status not in (Status.OK, Status.TIMEOUT):
        raise bus.failure(answer, f"servo {servo_id}: {register.name} cannot be written")
    if register.name == "baud_rate":
        bus.set_baud(BAUD_RATES[raw])
