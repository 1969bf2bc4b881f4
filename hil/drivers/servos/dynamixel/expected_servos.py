"""Compares the servos that answer at open with those that the bench expects."""

from collections import Counter

from hil.config.servo_models import ServoModel, model_text, models_text, servo_models, shared_register
from hil.config.servo_models.x_series_codes import BAUD_RATES, MODE_NAMES, VELOCITY
from hil.config.servos import STEER_MODES, ServosConfig
from hil.core.clock import Clock
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.signals import SERVOS, Status
from hil.drivers.servos.dynamixel.bus import Bus
from hil.drivers.servos.dynamixel.packets import Answer
from hil.drivers.servos.dynamixel.register_map import RegisterMap, from_block

_PAUSE_NS = 100_000_000
_PATIENCE_NS = 1_500_000_000
_LEFTOVERS_NS = 300_000_000
"""Time after which the answers to another program's requests have arrived."""
_NO_SERVO_LINE = (
    "most answers are garbled: another device at this port, a wrong servos.baud, or noise; "
    "check servos.port, ask `hil discover --port PORT` what is there, then look at cable and ground"
)
_UNCLEAR = (Status.TIMEOUT, Status.CRC, Status.PROTOCOL)


def read_blocks(bus: Bus, config: ServosConfig, clock: Clock) -> list[Answer]:
    """Registers 0..147 of the eight servos; those without a clean answer are read again for up to 1.5 s.

    Raises nothing.

    The model is not known yet: these registers are at the same place in all models that have a table.
    A silent servo need not be missing: it may be starting up after a dip of its supply, or the host may be
    busy starting programs. A garbled answer need not mean a wrong servo: the answer to a program that was
    killed in the middle of a request may still be on its way.
    """
    length = shared_register("backup_ready").end
    answers = [bus.read(i, 0, length) for i in config.ids]
    began_ns = clock.now_ns()
    while (passed_ns := clock.now_ns() - began_ns) < _PATIENCE_NS:
        worth_asking = (Status.TIMEOUT,) if passed_ns > _LEFTOVERS_NS else _UNCLEAR
        unclear = [k for k, answer in enumerate(answers) if answer.status in worth_asking]
        if not unclear:
            break
        clock.sleep_until_ns(clock.now_ns() + _PAUSE_NS)
        for k in unclear:
            answers[k] = bus.read(config.ids[k], 0, length)
    return answers


def identified(bus: Bus, config: ServosConfig, answers: list[Answer], device: str) -> ServoModel:
    """The model of the eight servos.

    Raises:
        DeviceError: they are not what the bench expects, not of one model, or of one that has no control
            table; with a table of what was found.
    """
    number = config.model_number or _commonest(answers)
    problems, remedies = [], []
    for name, servo_id, answer in zip(SERVOS, config.ids, answers, strict=True):
        found, remedy = _identity_problem(answer, config, number)
        if found:
            problems.append(f"{name} (ID {servo_id}): found {found}")
            remedies.append(remedy)
    if not problems:
        return servo_models()[number]
    all_silent = all(a.status is Status.TIMEOUT for a in answers)
    if all_silent:
        remedies = [_other_baud(bus, config)]
    garbled = sum(a.status not in (Status.OK, Status.TIMEOUT) for a in answers)
    if garbled > len(answers) // 2:
        remedies = [_NO_SERVO_LINE]
    kind = DeviceTimeoutError if all_silent else DeviceError
    raise kind(
        device,
        f"{len(problems)} of 8 servos are not what the bench expects\n  " + "\n  ".join(problems) + "\n ",
        port=config.port,
        expected=(
            f"model {model_text(number)}" if config.model_number else f"eight of one model of {models_text()}"
        )
        + f", firmware >= {config.min_firmware} at {config.baud} baud",
        remedy="; ".join(dict.fromkeys(remedies)),
    )


def _commonest(answers: list[Answer]) -> int:
    """Model number that most servos report, of those that have a table; 0 where none has."""
    numbers = [_model_number(a) for a in answers if a.status is Status.OK]
    known = Counter(n for n in numbers if n in servo_models())
    return max(known, key=known.__getitem__, default=0)


def _model_number(answer: Answer) -> int:
    return from_block(answer.data, shared_register("model_number"))


def _identity_problem(answer: Answer, config: ServosConfig, expected: int) -> tuple[str, str]:
    """(what was found, remedy), empty when the servo is right."""
    if answer.status is Status.TIMEOUT:
        return "nothing", "check cable, power and ID; `hil discover` lists the servos that answer"
    if answer.status is not Status.OK:
        return (
            f"garbled replies ({answer.status.value})",
            "two servos may share this ID: connect one at a time and give it another with "
            "`hil setup ... --new-id`",
        )
    number = _model_number(answer)
    firmware = from_block(answer.data, shared_register("firmware_version"))
    found = f"model {model_text(number)}, firmware {firmware}"
    model = servo_models().get(number)
    if model is None:
        return found, f"exchange the servo: units and ranges are known of {models_text()} only"
    if number != expected:
        if config.model_number is None:
            return (
                found,
                f"exchange the servo: all eight must be of one model, others are {model_text(expected)}",
            )
        return (found, f"set servos.model_number = {number} if all eight are that, or exchange the servo")
    if firmware < max(config.min_firmware, model.table["bus_watchdog"].firmware):
        return found, "update the firmware with DYNAMIXEL Wizard"
    return "", ""


def _other_baud(bus: Bus, config: ServosConfig) -> str:
    """Remedy text for silent servos: the baud rate at which they answer, or a general one."""
    found = []
    for baud in BAUD_RATES.values():
        if baud == config.baud:
            continue
        bus.set_baud(baud)
        if any(bus.ping(i).status is Status.OK for i in config.ids[:2]):
            found.append(baud)
    bus.set_baud(config.baud)
    if found:
        return f"the servos answer at {found[0]} baud: set servos.baud, or change theirs, one at a time: " + (
            setup_command(config, config.ids[0], f"--new-baud {config.baud}", baud=found[0])
        )
    return "check that the bus has power and that port and baud rate are right"


def setup_command(config: ServosConfig, servo_id: int, change: str, *, baud: int | None = None) -> str:
    """The command that changes the EEPROM of one servo, as a person would type it."""
    now = config.baud if baud is None else baud
    return f"`hil setup --port {config.port} --baud {now} --id {servo_id} {change}`"


def expected_mode(config: ServosConfig, joint: int) -> int:
    """Operating mode that a joint's servo must have."""
    return VELOCITY if joint < 4 else STEER_MODES[config.steer_mode]


def check_setup(config: ServosConfig, registers: RegisterMap, blocks: list[bytes], device: str) -> None:
    """Raise `DeviceError` where the EEPROM differs from what the bench needs; nothing is written."""
    problems: list[str] = []
    commands: list[str] = []
    for joint, block in enumerate(blocks):
        wrong = _setup_problems(config, registers, joint, block)
        problems += [f"{SERVOS[joint]} (ID {config.ids[joint]}): {reported}" for reported, _ in wrong]
        if wrong:
            change = " ".join(f"--register {setting}" for _, setting in wrong)
            commands.append(setup_command(config, config.ids[joint], change))
    if problems:
        exchanged = _exchanged_ids(config, [registers.from_block(b, "operating_mode") for b in blocks])
        unless = "if the IDs in the bench file are right, " if exchanged else ""
        raise DeviceError(
            device,
            "servos are not set up for this bench\n  " + "\n  ".join(problems) + "\n ",
            port=config.port,
            expected="these registers in the EEPROM",
            remedy=f"{exchanged}nothing is written by itself; {unless}write them with\n  "
            + "\n  ".join(commands),
        )


def _exchanged_ids(config: ServosConfig, modes: list[int]) -> str:
    """Remedy text where as many drives have the steering mode as steering servos have the drive mode.

    Such servos are set up well, but their IDs are exchanged. Writing the expected modes into the EEPROM
    would let a steering axis turn without end.
    """
    steering = STEER_MODES[config.steer_mode]
    drives = [k for k in range(4) if modes[k] == steering]
    axes = [k for k in range(4, 8) if modes[k] == VELOCITY]
    if not drives or len(drives) != len(axes):
        return ""
    named = [", ".join(f"{SERVOS[k]} (ID {config.ids[k]})" for k in some) for some in (drives, axes)]
    ids = [", ".join(str(config.ids[k]) for k in some) for some in (drives, axes)]
    return (
        f"{named[0]} and {named[1]} have each other's operating mode: probably their IDs are exchanged in "
        f"the bench file; first exchange {ids[0]} in servos.drive_ids and {ids[1]} in servos.steer_ids; "
    )


def _setup_problems(
    config: ServosConfig, registers: RegisterMap, joint: int, block: bytes
) -> list[tuple[str, str]]:
    """(what is wrong, the register as it should be) of one servo."""
    mode, want = registers.from_block(block, "operating_mode"), expected_mode(config, joint)
    problems = []
    if mode != want:
        found = f"{mode} ({MODE_NAMES.get(mode, 'unknown')})"
        message = f"operating_mode {found}, expected {want} ({MODE_NAMES[want]})"
        problems.append((message, f"operating_mode={want}"))
    for name, why in (
        ("drive_mode", "signs belong to the bench file"),
        ("homing_offset", "zeros belong to the calibration; with a bus watchdog an offset moves the motor"),
    ):
        raw = registers.from_block(block, name)
        if raw != 0:
            problems.append((f"{name} {raw}, expected 0 ({why})", f"{name}=0"))
    return problems


def reads_fast(config: ServosConfig, registers: RegisterMap, blocks: list[bytes]) -> bool:
    """Whether fast sync reads are to be used: as configured, or where every firmware has them."""
    if config.fast_sync_read == "auto":
        oldest = min(registers.from_block(b, "firmware_version") for b in blocks)
        return oldest >= registers.model.fast_read_firmware
    return config.fast_sync_read


def described(config: ServosConfig, registers: RegisterMap, blocks: list[bytes]) -> dict[str, str]:
    """Model, firmware, IDs and port, as a recording names them."""
    return {
        "model": f"{registers.model.name} ({registers.model.number})",
        "firmware": ", ".join(str(registers.from_block(b, "firmware_version")) for b in blocks),
        "ids": ", ".join(str(i) for i in config.ids),
        "port": config.port,
        "baud": str(config.baud),
    }
