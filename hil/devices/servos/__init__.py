"""The eight servos: four drives and four steers on one bus."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hil.config.servo_models import model_text, models_text, servo_models
from hil.config.servo_models.codes import hardware_error_text
from hil.config.servos import ServosConfig
from hil.core.clock import Clock, nanoseconds
from hil.core.device import DeviceKind, Figures, Found, Plot, Topic, import_object
from hil.core.errors import HilError
from hil.core.finding import Finding
from hil.core.geometry import Array
from hil.core.signals import SERVOS, Inputs, ServoSample, worst
from hil.devices.doctor_watch import Watched, losses
from hil.devices.serial_and_can_models import SerialModel

if TYPE_CHECKING:
    from hil.drivers.servos import FoundServo
    from hil.recording.ros_types import MessageMaker

__all__ = ["KIND", "joint_state"]

_HOT_C = 70.0
_VELOCITY_MODE = 1
_WHEELS = 4


class Dynamixel(SerialModel):
    """Eight servos on one bus; discovery looks for each of them, at every baud rate."""

    kind, name, title = "servos", "dynamixel", "Dynamixel X servos on RS-485 or TTL"
    config, probe_order = ServosConfig, 9
    wire, framing = "bus", "dynamixel"
    driver, chip = "hil.drivers.servos:DynamixelServos", "hil.fakes.servos:ServoBus"
    probe_writes = "a ping of all Dynamixel servos, at each of their baud rates"

    def emulate(self, request: Any) -> Any:
        """Emulate the bus behind an adapter with the latency of the table."""
        from hil.devices.emulated_device import on_serial_line

        config: ServosConfig = request.config
        reported = {"baud": config.baud, "ids": list(config.ids)}
        bus = import_object(self.chip).build(request)
        return on_serial_line(request, bus, latency_s=config.usb_latency_s, printed=reported)

    def probe(self, port: str, clock: Clock) -> Found | None:
        """Find the servos that answer on a port, at any baud rate; takes almost a second for each."""
        from hil.drivers.servos import scan

        servos: tuple[FoundServo, ...] = ()
        with contextlib.suppress(HilError):
            servos = scan(port, clock)
        return _described(port, servos) if servos else None


def _described(port: str, servos: Sequence[FoundServo]) -> Found:
    from hil.links.network_ports import SOCKET

    bauds, models = sorted({s.baud for s in servos}), sorted({s.model for s in servos})
    table: dict[str, Any] = {"port": port, "baud": bauds[0]}
    notes = []
    if port.lower().startswith(SOCKET):
        notes.append(f"the server at {port} sets the baud rate: set servos.baud to the rate of its port")
    if len(models) > 1 or models[0] not in servo_models():
        notes.append(
            f"servos of model {', '.join(map(model_text, models))} at {port}: "
            f"a bench needs eight of one model, {models_text()}"
        )
    else:
        table["model_number"] = models[0]
    if len(bauds) > 1:
        notes.append(f"the servos at {port} have different baud rates {bauds}: use hil setup")
    drives = sorted(s.servo_id for s in servos if s.operating_mode == _VELOCITY_MODE)
    steers = sorted(s.servo_id for s in servos if s.operating_mode != _VELOCITY_MODE)
    if len(drives) == len(steers) == _WHEELS:
        table |= {"drive_ids": drives, "steer_ids": steers}
        notes.append("check that the IDs are in the order FL, BL, BR, FR: hil run bring_up")
    else:
        notes.append(
            f"{len(servos)} servo(s) at {port}, of which {len(drives)} in velocity mode; "
            "a bench needs four drives (velocity mode) and four steers: use hil setup"
        )
    return Found(table, tuple(notes), tuple(servos))


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
