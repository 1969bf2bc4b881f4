"""Finds servos at a port, and makes their table of a bench file."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import Any

from hil.config.servo_models import model_text, models_text, servo_models
from hil.core.clock import Clock
from hil.core.device import Found
from hil.core.errors import HilError
from hil.drivers.servos import FoundServo, scan

_VELOCITY_MODE = 1
_WHEELS = 4


def ask(port: str, clock: Clock) -> Found | None:
    """Ask a port at every baud rate; takes almost a second for each."""
    servos: tuple[FoundServo, ...] = ()
    with contextlib.suppress(HilError):
        servos = scan(port, clock)
    return _described(port, servos) if servos else None


def _described(port: str, servos: Sequence[FoundServo]) -> Found:
    bauds, models = sorted({s.baud for s in servos}), sorted({s.model for s in servos})
    table: dict[str, Any] = {"port": port, "baud": bauds[0]}
    notes = []
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
