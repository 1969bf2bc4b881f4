"""What the doctor asks of the servos: samples, hardware errors, supply and temperature."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from hil.config.servo_models.codes import hardware_error_text
from hil.core.clock import nanoseconds
from hil.core.finding import Finding
from hil.core.signals import SERVOS, worst
from hil.devices.doctor_watch import Watched, losses

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
