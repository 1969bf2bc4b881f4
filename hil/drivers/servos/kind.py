"""The eight servos: four drives and four steers on one bus."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hil.config.servo_models.x_series_codes import hardware_error_text
from hil.core.clock import nanoseconds
from hil.core.device import DeviceKind, Figures, Plot, Topic
from hil.core.finding import Finding
from hil.core.geometry import Array
from hil.core.signals import SERVOS, Inputs, ServoSample, worst
from hil.drivers.doctor_watch import Watched, losses
from hil.drivers.servos.dynamixel.model import Dynamixel

if TYPE_CHECKING:
    from hil.recording.rosbags_adapter import MessageMaker

__all__ = ["KIND", "joint_state"]

_HOT_C = 70.0


def look(watched: Watched) -> Iterator[Finding]:
    """Findings about servos that were watched."""
    statuses = (worst(sample) for sample in watched.samples)
    yield losses("servos", statuses, watched.due, "check cables, termination and supply; lower the baud rate")
    alerts = {
        SERVOS[i]: hardware_error_text(code)
        for s in watched.samples
        for i, code in enumerate(s.alert)
        if code
    }
    yield Finding(
        "servos",
        "hardware errors",
        "failure" if alerts else "ok",
        ", ".join(f"{servo}: {error}" for servo, error in alerts.items()) or "none",
        "none",
        "remove the cause, then switch the servos' supply off and on",
    )
    yield from _health(watched, watched.device)


def _health(watched: Watched, servos: Any) -> Iterator[Finding]:
    clock = watched.clock
    clock.sleep_until_ns(clock.now_ns() + nanoseconds(watched.config.health_period_s))
    servos.read()
    found = servos.read_health()
    if not found:
        yield Finding("servos", "health", "warning", "voltage and temperature were not answered")
        return
    volts, celsius = found[-1].voltage_v, found[-1].temperature_c
    low_v: float = servos.model.low_supply_v
    low, hot = np.nanmin(volts) < low_v, np.nanmax(celsius) > _HOT_C
    yield Finding(
        "servos",
        "supply",
        "warning" if low else "ok",
        f"{np.nanmin(volts):.1f} to {np.nanmax(volts):.1f} V",
        f"at least {low_v:g} V",
        "charge or replace the battery; check the wiring",
    )
    yield Finding(
        "servos",
        "temperature",
        "warning" if hot else "ok",
        f"up to {np.nanmax(celsius):.0f} C",
        f"below {_HOT_C:g} C",
        "let the servos cool; look for a jam",
    )


def joint_state(sample: ServoSample, ros: MessageMaker) -> Any:
    """`sensor_msgs/JointState` of the servos' own angles; effort holds the current in A."""
    columns = sample.position_rad, sample.velocity_rad_s, sample.current_a
    return ros.joints(sample.stamp.t_ns, SERVOS, *columns)


class Servos(DeviceKind):
    """Four drives and four steers."""

    name, noun, sample = "servos", "servo positions", ServoSample
    models, aliases, labels = (Dynamixel(),), ("servo",), SERVOS
    moves_robot = True
    max_age_s, max_gap_s, min_delivered = 0.005, 0.05, 0.98
    topics = (Topic("/joint_states", "sensor_msgs/msg/JointState", joint_state),)
    plots = (
        Plot("Servos", "Servo angles (rad)", "servos/position_rad"),
        Plot("Servos", "Servo rates (rad/s)", "servos/velocity_rad_s"),
        Plot("Servos", "Motor currents (A)", "servos/current_a"),
        Plot("Health", "Temperatures (C)", "servos/temperature_c"),
        Plot("Health", "Voltages (V)", "servos/voltage_v"),
    )
    motion_threshold = 0.01  # rad: a servo holds its place within three counts, 0.005
    silent_faults: ClassVar[Mapping[str, str]] = {"slow": "answers come later, but before their timeout"}

    def stale_after_s(self, safety: Any, config: Any) -> float:
        """`safety.servo_stale_s`."""
        return float(safety.servo_stale_s)

    def rate_hz(self, config: Any, loop_hz: float) -> float:
        """The loop rate: they are read in each cycle."""
        return loop_hz

    def figures(self, inputs: Inputs) -> Iterator[tuple[str, Figures]]:
        """Angles, rates, currents, temperatures and voltages."""
        if inputs.servos:
            sample = inputs.servos[-1]
            yield "servos/position_rad", _by_servo(sample.position_rad)
            yield "servos/velocity_rad_s", _by_servo(sample.velocity_rad_s)
            yield "servos/current_a", _by_servo(sample.current_a)
        if inputs.health:
            yield "servos/temperature_c", _by_servo(inputs.health[-1].temperature_c)
            yield "servos/voltage_v", _by_servo(inputs.health[-1].voltage_v)

    def motion_value(self, sample: ServoSample) -> Array | None:
        """Angles (8,) in rad."""
        return sample.position_rad if sample.ok else None

    def check(self, watched: Watched) -> Iterator[Finding]:
        """Samples, hardware errors, supply, temperature."""
        return look(watched)


def _by_servo(values: Array) -> Figures:
    return dict(zip(SERVOS, values.tolist(), strict=True))


KIND = Servos()
