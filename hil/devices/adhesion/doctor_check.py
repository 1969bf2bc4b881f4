"""What the doctor asks of the fan: its reports, battery and heat; its driver tells how it is set and kept."""

from __future__ import annotations

import math
from collections.abc import Iterator

from hil.config.adhesion import AdhesionConfig
from hil.core.finding import Finding, Level
from hil.devices.doctor_watch import Watched, losses


def look(watched: Watched) -> Iterator[Finding]:
    """Findings about a fan that was watched."""
    samples, config = watched.samples, watched.config
    assert isinstance(config, AdhesionConfig)
    remedy = "switch on status message 1 at 50 Hz; check the CAN wiring"
    yield losses("adhesion", (s.status for s in samples), max(watched.due, 1), remedy)
    if not samples:
        return
    newest = samples[-1]
    yield _held(
        "battery",
        newest.input_v,
        "V",
        newest.input_v > config.low_input_v,
        f"over {config.low_input_v:g} V",
        "charge the fan's battery; switch on status message 5",
    )
    yield _held(
        "power stage",
        newest.fet_c,
        "degC",
        newest.fet_c < config.hot_fet_c,
        f"below {config.hot_fet_c:g} degC",
        "let it cool down; switch on status message 4",
    )
    force_n = config.force_at_n(newest.speed_rpm)
    yield Finding("adhesion", "speed", "ok", f"{newest.speed_rpm:.0f} 1/min, good for {force_n:.1f} N")


def _held(check: str, value: float, unit: str, right: bool, expected: str, remedy: str) -> Finding:
    known = math.isfinite(value)
    level: Level = "ok" if right else "failure" if known else "warning"
    return Finding(
        "adhesion", check, level, f"{value:.1f} {unit}" if known else "not reported", expected, remedy
    )
