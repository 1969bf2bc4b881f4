"""The model `dynamixel` of the kind `servos`."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from hil.config.servo_models import model_text, models_text, servo_models
from hil.config.servos import ServosConfig
from hil.core.clock import Clock
from hil.core.device import Found
from hil.core.errors import HilError
from hil.drivers.serial_and_can_models import SerialModel

if TYPE_CHECKING:
    from hil.drivers.servos.dynamixel.commissioning import FoundServo


_VELOCITY_MODE = 1


_WHEELS = 4


class Dynamixel(SerialModel):
    """Eight servos on one bus; discovery looks for each of them, at every baud rate."""

    kind, name, title = "servos", "dynamixel", "Dynamixel X servos on RS-485 or TTL"
    config, probe_order = ServosConfig, 9
    wire, framing, printed = "bus", "dynamixel", ("baud", "ids")
    driver, chip = (
        "hil.drivers.servos.dynamixel.driver:DynamixelServos",
        "hil.fakes.servos.dynamixel.chip:ServoBus",
    )
    probe_writes = "a ping of all Dynamixel servos, at each of their baud rates"

    def probe(self, port: str, clock: Clock) -> Found | None:
        """Find the servos that answer on a port, at any baud rate; takes almost a second for each."""
        from hil.drivers.servos.dynamixel.commissioning import scan

        servos: tuple[FoundServo, ...] = ()
        with contextlib.suppress(HilError):
            servos = scan(port, clock)
        return _described(port, servos) if servos else None


def _described(port: str, servos: Sequence[FoundServo]) -> Found:
    from hil.links.serial_over_tcp import SOCKET

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
