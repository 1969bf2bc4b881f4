"""Checks of an open servo bus: reply time, return delay, packets, hardware errors, limits."""

import math

from hil.config.servo_models.x_series_codes import RETURN_DELAY_STEP_S, hardware_error_text
from hil.config.servos import ServosConfig
from hil.core.clock import NS_PER_S, Clock
from hil.core.finding import Finding
from hil.core.signals import SERVOS, Status
from hil.drivers.servos.dynamixel.bus import Bus
from hil.drivers.servos.dynamixel.expected_servos import setup_command
from hil.drivers.servos.dynamixel.register_map import RegisterMap
from hil.links.serial_url import latency_timer

_SHORT_READ_BYTES = 14 + 13
_SLOW_S = 0.008


def reply_time(bus: Bus, config: ServosConfig, clock: Clock, device: str) -> Finding:
    """Finding on the latency of adapter and host beyond the time on the wire, best of up to eight reads."""
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
    message = f"{kept_s * 1e3:.1f} ms beyond the wire" if math.isfinite(kept_s) else "no reply"
    timer = latency_timer(config.port)
    return Finding(
        device,
        "reply time",
        "ok" if kept_s <= limit_s else "warning",
        message,
        f"below {limit_s * 1e3:g} ms",
        "an adapter as delivered keeps replies for 16 ms: set its latency timer to 1 ms"
        + (f": echo 1 | sudo tee {timer}" if timer else ""),
    )


def findings(
    config: ServosConfig,
    registers: RegisterMap,
    blocks: list[bytes],
    device: str,
    *,
    fast: bool,
    mapped: bool,
) -> tuple[Finding, ...]:
    """Findings on the servos' settings on an open bus.

    Args:
        config: settings that the bench expects.
        registers: register map of the servos' model.
        blocks: their registers as read at open.
        device: name in the findings.
        fast: True if fast sync reads are used.
        mapped: True if goals go through indirect data.
    """
    model, read = registers.model, registers.from_block
    delays = [read(b, "return_delay_time") * RETURN_DELAY_STEP_S for b in blocks]
    errors = {SERVOS[j]: read(b, "hardware_error_status") for j, b in enumerate(blocks)}
    alerts = ", ".join(f"{servo}: {hardware_error_text(bits)}" for servo, bits in errors.items() if bits)
    slow = [j for j, delay in enumerate(delays) if delay > config.return_delay_s + 1e-9]
    step = f"--register return_delay_time={round(config.return_delay_s / RETURN_DELAY_STEP_S)}"
    shutdown = [read(b, "shutdown") for b in blocks]
    protection = model.table["shutdown"].default
    open_to_harm = [j for j, s in enumerate(shutdown) if s & protection != protection]
    return (
        Finding(
            device,
            "return delay",
            "warning" if slow else "ok",
            f"up to {max(delays) * 1e6:.0f} us",
            f"{config.return_delay_s * 1e6:.0f} us",
            _for_each(config, slow, step),
        ),
        Finding(
            device,
            "reads",
            "ok" if fast else "warning",
            "fast sync read" if fast else "plain sync read",
            f"firmware {model.fast_read_firmware} on all servos",
            "update the firmware with DYNAMIXEL Wizard",
        ),
        Finding(
            device,
            "goals",
            "ok" if mapped else "warning",
            "one sync write" if mapped else "one bulk write",
            "the bench's indirect addresses",
            "release torque once, then open again",
        ),
        Finding(
            device,
            "hardware errors",
            "failure" if alerts else "ok",
            alerts or "none",
            "none",
            "remove the cause, then switch the servos' supply off and on",
        ),
        Finding(
            device,
            "shutdown",
            "warning" if open_to_harm else "ok",
            ", ".join(f"0x{s:02X}" for s in sorted(set(shutdown))),
            f"0x{protection:02X}",
            "let overload, shock and heat switch the motor off: "
            + _for_each(config, open_to_harm, f"--register shutdown={protection}"),
        ),
        _limits(config, registers, blocks, device),
    )


def _for_each(config: ServosConfig, joints: list[int], change: str) -> str:
    """The command for the first of some servos, and which others need it."""
    if not joints:
        return ""
    others = ", ".join(str(config.ids[j]) for j in joints[1:])
    return setup_command(config, config.ids[joints[0]], change) + (f", and for ID {others}" if others else "")


def _limits(config: ServosConfig, registers: RegisterMap, blocks: list[bytes], device: str) -> Finding:
    """Limits in the EEPROM against those of the bench: a goal beyond the servo's own is ignored."""
    model = registers.model

    def values(name: str, joints: slice = slice(0, 8)) -> list[float]:
        return [registers.from_block(b, name) * model.table[name].scale for b in blocks[joints]]

    def angles(name: str) -> list[float]:
        return [(v - model.zero_counts) * model.rad_per_count for v in values(name, slice(4, 8))]

    rate = min(values("velocity_limit", slice(0, 4)))
    low, high = max(angles("min_position_limit")), min(angles("max_position_limit"))
    wide = high >= config.steer_limit_rad and low <= -config.steer_limit_rad
    enough = rate >= config.velocity_limit_rad_s and (wide or config.steer_mode == "extended")
    return Finding(
        device,
        "limits",
        "ok" if enough else "warning",
        f"wheels {rate:.2f} rad/s, steering {low:.2f} to {high:.2f} rad, "
        f"{min(values('current_limit')):.2f} A, "
        f"{max(values('min_voltage_limit')):.1f} to {min(values('max_voltage_limit')):.1f} V, "
        f"{min(values('temperature_limit')):.0f} C",
        f"wheels {config.velocity_limit_rad_s:g} rad/s, steering +-{config.steer_limit_rad:.2f} rad",
        "write velocity_limit, min_position_limit and max_position_limit with `hil setup ... --register`, "
        "or lower the bench's limits",
    )
