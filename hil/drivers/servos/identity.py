"""Who is on the bus: what each ID answers at open, held against what the bench expects."""

from __future__ import annotations

import math

from hil.config.servos import STEER_MODES, ServosConfig
from hil.config.xh430 import (
    BAUD_RATES,
    FAST_READ_FIRMWARE,
    MODE_NAMES,
    MODELS,
    RAD_PER_COUNT,
    TABLE,
    VELOCITY,
    ZERO_COUNTS,
    hardware_error_text,
    model_text,
    models_text,
)
from hil.drivers.serial_url import latency_timer
from hil.drivers.servos import registers as reg
from hil.drivers.servos.bus import Bus
from hil.drivers.servos.packets import Answer
from hil.vocabulary.clock import NS_PER_S, Clock
from hil.vocabulary.errors import DeviceError, DeviceTimeoutError
from hil.vocabulary.finding import Finding
from hil.vocabulary.signals import SERVOS, Status

_PAUSE_NS = 100_000_000
_PATIENCE_NS = 1_500_000_000
_SHORT_READ_BYTES = 14 + 13
_SLOW_S = 0.008


def read_blocks(bus: Bus, config: ServosConfig, clock: Clock) -> list[Answer]:
    """Registers 0..147 of the eight servos; whoever is silent is asked again for a while. Raises nothing.

    A servo that is starting up after a dip of its supply, or a bus on a host that is busy starting programs,
    is not a missing one.
    """
    answers = [bus.read(i, 0, reg.BLOCK_LENGTH) for i in config.ids]
    end_ns = clock.now_ns() + _PATIENCE_NS
    while clock.now_ns() < end_ns:
        silent = [k for k, answer in enumerate(answers) if answer.status is Status.TIMEOUT]
        if not silent:
            break
        clock.sleep_until_ns(clock.now_ns() + _PAUSE_NS)
        for k in silent:
            answers[k] = bus.read(config.ids[k], 0, reg.BLOCK_LENGTH)
    return answers


def check_identity(bus: Bus, config: ServosConfig, answers: list[Answer], device: str) -> None:
    """Raise `DeviceError` with a table of expected and found unless the eight are the right ones."""
    problems, remedies = [], []
    for name, servo_id, answer in zip(SERVOS, config.ids, answers, strict=True):
        found, remedy = _identity_problem(answer, config)
        if found:
            problems.append(f"{name} (ID {servo_id}): found {found}")
            remedies.append(remedy)
    if not problems:
        return
    nobody = all(a.status is Status.TIMEOUT for a in answers)
    if nobody:
        remedies = [_other_baud(bus, config)]
    kind = DeviceTimeoutError if nobody else DeviceError
    raise kind(
        device,
        f"{len(problems)} of 8 servos are not what the bench expects\n  " + "\n  ".join(problems) + "\n ",
        port=config.port,
        expected=f"model {model_text(config.model_number)}, firmware >= {config.min_firmware} "
        f"at {config.baud} baud",
        remedy="; ".join(dict.fromkeys(remedies)),
    )


def _identity_problem(answer: Answer, config: ServosConfig) -> tuple[str, str]:
    """(what was found, remedy), empty when the servo is right."""
    if answer.status is Status.TIMEOUT:
        return "nothing", "check cable, power and ID; `hil discover` shows who answers"
    if answer.status is not Status.OK:
        return (
            f"garbled replies ({answer.status.value})",
            "two servos may share this ID: connect one at a time and give it another with "
            "`hil setup ... --new-id`",
        )
    model = reg.from_block(answer.data, "model_number")
    firmware = reg.from_block(answer.data, "firmware_version")
    found = f"model {model_text(model)}, firmware {firmware}"
    if model not in MODELS:
        return found, f"exchange the servo: units and ranges are known of {models_text()} only"
    if model != config.model_number:
        return (
            found,
            f"set servos.model_number = {model} if all eight are that, or exchange the servo",
        )
    if firmware < config.min_firmware:
        return found, "update the firmware with DYNAMIXEL Wizard"
    return "", ""


def _other_baud(bus: Bus, config: ServosConfig) -> str:
    """Whether the servos listen at another rate, as a remedy."""
    heard = []
    for baud in BAUD_RATES.values():
        if baud == config.baud:
            continue
        bus.set_baud(baud)
        if any(bus.ping(i).status is Status.OK for i in config.ids[:2]):
            heard.append(baud)
    bus.set_baud(config.baud)
    if heard:
        return f"the servos answer at {heard[0]} baud: set servos.baud, or change theirs, one at a time: " + (
            setup_command(config, config.ids[0], f"--new-baud {config.baud}", baud=heard[0])
        )
    return "check that the bus has power and that port and baud rate are right"


def setup_command(config: ServosConfig, servo_id: int, change: str, *, baud: int | None = None) -> str:
    """The command that changes the EEPROM of one servo, as a person would type it."""
    now = config.baud if baud is None else baud
    return f"`hil setup --port {config.port} --baud {now} --id {servo_id} {change}`"


def expected_mode(config: ServosConfig, joint: int) -> int:
    """Operating mode that a joint's servo must have."""
    return VELOCITY if joint < 4 else STEER_MODES[config.steer_mode]


def check_setup(config: ServosConfig, blocks: list[bytes], device: str) -> None:
    """Raise `DeviceError` where the EEPROM differs from what the bench needs; nothing is written."""
    problems: list[str] = []
    commands: list[str] = []
    for joint, block in enumerate(blocks):
        wrong = _setup_problems(config, joint, block)
        problems += [f"{SERVOS[joint]} (ID {config.ids[joint]}): {told}" for told, _ in wrong]
        if wrong:
            change = " ".join(f"--register {setting}" for _, setting in wrong)
            commands.append(setup_command(config, config.ids[joint], change))
    if problems:
        raise DeviceError(
            device,
            "servos are not set up for this bench\n  " + "\n  ".join(problems) + "\n ",
            port=config.port,
            expected="these registers in the EEPROM",
            remedy="nothing is written by itself; write them with\n  " + "\n  ".join(commands),
        )


def _setup_problems(config: ServosConfig, joint: int, block: bytes) -> list[tuple[str, str]]:
    """(what is wrong, the register as it should be) of one servo."""
    mode, want = reg.from_block(block, "operating_mode"), expected_mode(config, joint)
    problems = []
    if mode != want:
        found = f"{mode} ({MODE_NAMES.get(mode, 'unknown')})"
        told = f"operating_mode {found}, expected {want} ({MODE_NAMES[want]})"
        problems.append((told, f"operating_mode={want}"))
    for name, why in (
        ("drive_mode", "signs belong to the bench file"),
        ("homing_offset", "zeros belong to the calibration; with a bus watchdog an offset moves the motor"),
    ):
        raw = reg.from_block(block, name)
        if raw != 0:
            problems.append((f"{name} {raw}, expected 0 ({why})", f"{name}=0"))
    return problems


def reads_fast(config: ServosConfig, blocks: list[bytes]) -> bool:
    """Whether fast sync reads are to be used: as configured, or where every firmware has them."""
    if config.fast_sync_read == "auto":
        return min(reg.from_block(b, "firmware_version") for b in blocks) >= FAST_READ_FIRMWARE
    return config.fast_sync_read


def described(config: ServosConfig, blocks: list[bytes]) -> dict[str, str]:
    """Models, firmware, IDs and port, as a recording names them."""
    return {
        "model": f"{MODELS[config.model_number]} ({config.model_number})",
        "firmware": ", ".join(str(reg.from_block(b, "firmware_version")) for b in blocks),
        "ids": ", ".join(str(i) for i in config.ids),
        "port": config.port,
        "baud": str(config.baud),
    }


def reply_time(bus: Bus, config: ServosConfig, clock: Clock, device: str) -> Finding:
    """How long adapter and host keep a reply beyond its time on the wire: the best of some."""
    limit_s = min(config.usb_latency_s + config.reply_slack_s, _SLOW_S)
    wire_s = bus.port.wire_s(_SHORT_READ_BYTES) + bus.port.return_delay_s
    kept_s = math.inf
    with bus.port.patient():
        for servo_id in config.ids:
            start_ns = clock.now_ns()
            if bus.read(servo_id, 0, 2, attempts=1).status is Status.OK:
                kept_s = min(kept_s, max(0.0, (clock.now_ns() - start_ns) / NS_PER_S - wire_s))
            if kept_s <= limit_s:
                break
    told = f"{kept_s * 1e3:.1f} ms beyond the wire" if math.isfinite(kept_s) else "no reply"
    timer = latency_timer(config.port)
    return Finding(
        device, "reply time", "ok" if kept_s <= limit_s else "warning", told,
        f"below {limit_s * 1e3:g} ms",
        "an adapter as delivered keeps replies for 16 ms: set its latency timer to 1 ms"
        + (f": echo 1 | sudo tee {timer}" if timer else ""),
    )  # fmt: skip


def findings(
    config: ServosConfig, blocks: list[bytes], device: str, *, fast: bool, mapped: bool
) -> tuple[Finding, ...]:
    """What a check of the bus tells, beyond that it opened."""
    delays = [reg.from_block(b, "return_delay_time") * 2e-6 for b in blocks]
    errors = {SERVOS[j]: reg.from_block(b, "hardware_error_status") for j, b in enumerate(blocks)}
    alerts = ", ".join(f"{servo}: {hardware_error_text(bits)}" for servo, bits in errors.items() if bits)
    slow = [j for j, delay in enumerate(delays) if delay > config.return_delay_s + 1e-9]
    step = f"--register return_delay_time={round(config.return_delay_s / TABLE['return_delay_time'].scale)}"
    shutdown = [reg.from_block(b, "shutdown") for b in blocks]
    protection = TABLE["shutdown"].default
    open_to_harm = [j for j, s in enumerate(shutdown) if s & protection != protection]
    return (
        Finding(
            device, "return delay", "warning" if slow else "ok", f"up to {max(delays) * 1e6:.0f} us",
            f"{config.return_delay_s * 1e6:.0f} us", _for_each(config, slow, step),
        ),
        Finding(
            device, "reads", "ok" if fast else "warning", "fast sync read" if fast else "plain sync read",
            f"firmware {FAST_READ_FIRMWARE} on all servos", "update the firmware with DYNAMIXEL Wizard",
        ),
        Finding(
            device, "goals", "ok" if mapped else "warning", "one sync write" if mapped else "one bulk write",
            "the bench's indirect addresses", "release torque once, then open again",
        ),
        Finding(
            device, "hardware errors", "failure" if alerts else "ok", alerts or "none", "none",
            "remove the cause, then switch the servos' supply off and on",
        ),
        Finding(
            device, "shutdown", "warning" if open_to_harm else "ok",
            ", ".join(f"0x{s:02X}" for s in sorted(set(shutdown))), f"0x{protection:02X}",
            "let overload, shock and heat switch the motor off: "
            + _for_each(config, open_to_harm, f"--register shutdown={protection}"),
        ),
        _limits(config, blocks, device),
    )  # fmt: skip


def _for_each(config: ServosConfig, joints: list[int], change: str) -> str:
    """The command for the first of some servos, and which others need it."""
    if not joints:
        return ""
    others = ", ".join(str(config.ids[j]) for j in joints[1:])
    return setup_command(config, config.ids[joints[0]], change) + (f", and for ID {others}" if others else "")


def _limits(config: ServosConfig, blocks: list[bytes], device: str) -> Finding:
    """Limits in the EEPROM against those of the bench: a goal beyond the servo's own is ignored."""

    def values(name: str, joints: slice = slice(0, 8)) -> list[float]:
        return [reg.from_block(b, name) * TABLE[name].scale for b in blocks[joints]]

    rate = min(values("velocity_limit", slice(0, 4)))
    low = max((v - ZERO_COUNTS) * RAD_PER_COUNT for v in values("min_position_limit", slice(4, 8)))
    high = min((v - ZERO_COUNTS) * RAD_PER_COUNT for v in values("max_position_limit", slice(4, 8)))
    wide = high >= config.steer_limit_rad and low <= -config.steer_limit_rad
    enough = rate >= config.velocity_limit_rad_s and (wide or config.steer_mode == "extended")
    return Finding(
        device, "limits", "ok" if enough else "warning",
        f"wheels {rate:.2f} rad/s, steering {low:.2f} to {high:.2f} rad, "
        f"{min(values('current_limit')):.2f} A, "
        f"{max(values('min_voltage_limit')):.1f} to {min(values('max_voltage_limit')):.1f} V, "
        f"{min(values('temperature_limit')):.0f} C",
        f"wheels {config.velocity_limit_rad_s:g} rad/s, steering +-{config.steer_limit_rad:.2f} rad",
        "write velocity_limit, min_position_limit and max_position_limit with `hil setup ... --register`, "
        "or lower the bench's limits",
    )  # fmt: skip
