"""`hil setup`: write one servo's EEPROM: ID, baud rate, operating mode, return delay."""

import json

import click

from hil.cli.options import JSON
from hil.core.errors import EXIT_PASS, UsageError

_ROLES = {"drive": {"operating_mode": 1}, "steer": {"operating_mode": 3}}


@click.command()
@click.option("--port", required=True, help="Serial port or pyserial URL of the bus.")
@click.option("--baud", default=57_600, show_default=True, help="Baud rate that the servo has now.")
@click.option("--id", "servo_id", type=click.IntRange(0, 252), required=True, help="ID that it has now.")
@click.option("--new-id", type=click.IntRange(0, 252), help="ID that it gets.")
@click.option("--new-baud", type=int, help="Baud rate that it gets.")
@click.option("--role", type=click.Choice(sorted(_ROLES)), help="Operating mode for driving or steering.")
@click.option("--register", "pairs", multiple=True, metavar="NAME=VALUE", help="Further EEPROM register.")
@click.option("--dry-run", is_flag=True, help="Read and check what would change; write nothing.")
@JSON
def command(
    port: str,
    baud: int,
    servo_id: int,
    new_id: int | None,
    new_baud: int | None,
    role: str | None,
    pairs: tuple[str, ...],
    dry_run: bool,
    as_json: bool,
) -> int:
    """Set up one servo; the only command that writes EEPROM. Connect one new servo at a time.

    Return Delay Time is set to 0 unless given, torque is off while writing, and everything is read back.

    Example: hil setup --port /dev/ttyUSB0 --id 1 --new-id 11
    """
    from hil.bench import set_up
    from hil.core.clock import MonotonicClock

    _must_not_hold(port)
    registers = {"return_delay_time": 0, **(_ROLES[role] if role else {}), **dict(map(_pair, pairs))}
    found = set_up(
        port,
        MonotonicClock(),
        baud=baud,
        servo_id=servo_id,
        new_id=new_id,
        new_baud=new_baud,
        registers=registers,
        dry_run=dry_run,
    )
    if as_json:
        reported = {"port": port, "id": servo_id, "registers": found, "written": not dry_run}
        click.echo(json.dumps(reported))
    else:
        changes = (f"{name} {before} -> {after}" for name, (before, after) in found.items())
        mark = "would write to " if dry_run else ""
        click.echo(f"{mark}servo {servo_id} at {port}: " + ", ".join(changes))
    return EXIT_PASS


def _must_not_hold(port: str) -> None:
    """Refuse a port that, by a bench file of this folder or by its USB ids, holds the robot."""
    from pathlib import Path

    from hil.bench.doctor.protected_ports import ports_that_hold, why_it_holds

    if why := why_it_holds(port, ports_that_hold((), Path())):
        raise UsageError(
            f"--port {port}: {why}", expected="the port of the servos", remedy="`hil discover` finds it"
        )


def _pair(text: str) -> tuple[str, int]:
    name, _, value = text.partition("=")
    try:
        return name, int(value, 0)
    except ValueError:
        raise UsageError(
            f"--register {text!r}", expected="NAME=INTEGER, see hil/config/servo_models"
        ) from None
