"""`hil discover`: find ports, IDs and baud rates, and print a ready bench.toml."""

from __future__ import annotations

import contextlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.options import JSON, OUT, FileName
from hil.core.errors import EXIT_DEVICE, EXIT_PASS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from hil.bench.doctor.discovery import Discovery
    from hil.config.can_bus import CanConfig
    from hil.config.mocap import MocapConfig


@click.command()
@click.option("--port", "ports", multiple=True, help="Serial port or pyserial URL (repeatable).")
@click.option(
    "--can", "buses", multiple=True, metavar="INTERFACE:CHANNEL[:PORT]", help="CAN bus to probe (repeatable)."
)
@click.option("--mocap", metavar="ADDRESS[:PORT]", help="Motion-capture server, and its command port.")
@click.option(
    "--at",
    "places",
    multiple=True,
    metavar="KIND.KEY=VALUE",
    help="Where a device is, by a key of its table (repeatable); serial ports then need --port.",
)
@click.option(
    "--bench",
    "benches",
    type=FileName(path_type=Path),
    multiple=True,
    help="Bench file whose devices that hold the robot are left alone (repeatable); "
    "those of this folder are, too.",
)
@click.option("--on-stand", is_flag=True, help="The robot is on the floor or on a stand: do not ask.")
@click.option("--out", type=OUT, help="Write the bench file here; never overwrites.")
@JSON
def command(
    ports: tuple[str, ...],
    buses: tuple[str, ...],
    mocap: str | None,
    places: tuple[str, ...],
    benches: tuple[Path, ...],
    on_stand: bool,
    out: Path | None,
    as_json: bool,
) -> int:
    """Probe every place where a device could be.

    What is at a serial port is unknown before it is probed, and a propeller controller may slow down on bytes
    that it does not understand. So this prints what it will write to which port, and asks whether the robot
    stands. Ports that another program has open, or that belong to what holds a robot, are left alone.

    Ends with 3 if no device answers, or none at a given --port; with 4 if the robot may hang.

    Example: hil discover --out my.toml
    """
    from hil.bench.doctor.discovery import ASSUMED, discover, serial_ports
    from hil.bench.doctor.protected_ports import ports_that_hold, why_not_asked
    from hil.core.clock import MonotonicClock
    from hil.core.errors import UsageError
    from hil.support.atomic_files import check_new_file, write_text

    if "" in ports:
        raise UsageError("--port ''", expected="a serial port or a pyserial URL")
    if out is not None:
        check_new_file(out, "--out")
    given = _given(mocap, buses, places)
    listed = ports if ports or places else tuple(serial_ports())
    holding = ports_that_hold(benches, Path())
    left_alone = {port: why for port in listed if (why := why_not_asked(port, holding))}
    for port, why in left_alone.items():
        _say(f"not asked: {port}: {why}")
    _must_stand([port for port in listed if port not in left_alone], on_stand, benches)
    found = discover(MonotonicClock(), ports=listed, left_alone=left_alone, given=given, say=_say)
    for kind, where in found.missing.items():
        _say(f"not found: {kind}: {where}")
    for port in found.silent if ports else ():
        _say(f"nothing answered at {port}; check its name, power and cable")
    text = found.to_toml()
    if out is not None and found.sections:
        write_text(out, text)
        _say(f"wrote {out}; check it with hil doctor --bench {out}")
        _say(ASSUMED)
    if as_json:
        click.echo(json.dumps(_as_json(found)))
    elif out is None and found.sections:
        click.echo(text)
    if not found.sections:
        unwritten = f"; {out} was not written" if out is not None else ""
        click.echo(
            f"hil: nothing answered; check power and cables, and what is not asked above{unwritten}", err=True
        )
        return EXIT_DEVICE
    return EXIT_DEVICE if ports and (found.silent or found.not_asked) else EXIT_PASS


def _say(text: str) -> None:
    click.echo(f"hil: {text}", err=True)


def _must_stand(ports: list[str], on_stand: bool, benches: tuple[Path, ...]) -> None:
    """Print what will be written where; raise `Aborted` unless the operator says that the robot stands."""
    from hil.bench.doctor.discovery import what_is_written
    from hil.bench.doctor.protected_ports import what_is_kept
    from hil.core.errors import Aborted
    from hil.procedure.operator import Terminal

    if not ports:
        return
    for name in what_is_kept():
        file = benches[0] if benches else "FILE"
        _say(f"a robot may hang by what runs now: {name} (hil adhesion status --bench {file})")
    _say(f"will write to {', '.join(ports)}: {'; '.join(what_is_written())}")
    if on_stand:
        return
    question = "Is the robot on the floor or on a stand, so that nothing at these ports holds it? yes or no:"
    remedy = "put it on a stand, then give --on-stand"
    try:
        answer = Terminal().ask(question)
    except Aborted as error:
        raise Aborted(f"nothing was asked: {error.message}", remedy=remedy) from None
    if answer.strip().lower() not in ("y", "yes"):
        raise Aborted("nothing was asked: the robot may hang", expected="yes", remedy=remedy)


def _as_json(found: Discovery) -> dict[str, Any]:
    parts = {kind: [asdict(part) for part in parts] for kind, parts in found.parts.items() if parts}
    servos = {"servos": parts.pop("servos", [])}
    return {
        "sections": found.sections,
        **servos,
        **parts,
        "notes": found.notes,
        "missing": found.missing,
        "silent": found.silent,
        "not_asked": found.not_asked,
    }


def _given(mocap: str | None, buses: tuple[str, ...], places: tuple[str, ...]) -> dict[str, list[Any]]:
    """Tables of the places that the options name, by kind."""
    given: dict[str, list[Any]] = {"mocap": [_server(mocap)] if mocap else []}
    for text in buses:
        for kind, table in _on_bus(text):
            given.setdefault(kind, []).append(table)
    for kind, table in _tables(places).items():
        given[kind] = [*given.get(kind, []), table]
    return given


def _on_bus(text: str) -> Iterator[tuple[str, CanConfig]]:
    """Kind and table of every model that could be on a bus."""
    from hil.config.can_bus import SEARCH_S, CanConfig
    from hil.core.errors import UsageError
    from hil.core.registry import kinds

    interface, _, rest = text.partition(":")
    channel, _, port = rest.partition(":")
    if not interface or not channel or (port and not port.isdecimal()):
        raise UsageError(f"--can {text!r}", expected="INTERFACE:CHANNEL or INTERFACE:CHANNEL:PORT")
    options: dict[str, str | int | bool] = {"port": int(port)} if port else {}
    for model in (model for kind in kinds().values() for model in kind.models if model.can_search):
        if issubclass(model.config, CanConfig):
            table = {"interface": interface, "channel": channel, "options": options}
            yield model.kind, model.config(**table, open_timeout_s=SEARCH_S)


def _server(text: str) -> MocapConfig:
    from pydantic import ValidationError

    from hil.config.mocap import MocapConfig
    from hil.core.errors import UsageError

    address, _, port = text.partition(":")
    try:
        return MocapConfig.model_validate(
            {"server": address, **({"command_port": _scalar(port)} if port else {})}
        )
    except ValidationError as error:
        raise UsageError(
            f"--mocap {text!r}: {error.errors()[0]['msg']}",
            expected="an IPv4 address, or ADDRESS:COMMAND_PORT",
        ) from None


def _tables(places: tuple[str, ...]) -> dict[str, Any]:
    """Tables made of these keys and values, by kind; other keys keep the model's defaults."""
    from pydantic import ValidationError

    from hil.core.errors import UsageError
    from hil.core.registry import kind_of, kinds

    trees: dict[str, dict[str, Any]] = {}
    for text in places:
        where, equals, value = text.partition("=")
        name, _, key = where.partition(".")
        kind = kind_of(name)
        if kind is None or not key or not equals or not any(model.can_search for model in kind.models):
            sought = [
                name for name, kind in kinds().items() if any(model.can_search for model in kind.models)
            ]
            raise UsageError(f"--at {text!r}", expected=f"KIND.KEY=VALUE; kinds are {', '.join(sought)}")
        key, _, option = key.partition(".")
        tree = trees.setdefault(kind.name, {})
        if option:  # of a table within the table, as `options` of a CAN bus
            tree[key] = {**(tree.get(key) or {}), option: _scalar(value)}
        else:
            tree[key] = value
    tables = {}
    for name, tree in trees.items():
        models = {model.name: model for model in kinds()[name].models}
        model = models.get(tree.get("model", next(iter(models))))
        if model is None:
            raise UsageError(f"--at {name}.model={tree['model']}", expected="one of " + ", ".join(models))
        try:
            tables[name] = model.config.model_validate(_typed(tree, model.config.model_fields))
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, (name, *first["loc"])))
            raise UsageError(
                f"--at {where}: {first['msg']}", expected="one of " + ", ".join(model.config.model_fields)
            ) from None
    return tables


def _typed(tree: dict[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """A table of texts, converted to numbers and booleans where the keys need them."""
    return {
        key: _scalar(value)
        if isinstance(value, str) and key in known and known[key].annotation is not str
        else value
        for key, value in tree.items()
    }


def _scalar(text: str) -> bool | int | float | str:
    """A value as a bench file would have it."""
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return {"true": True, "false": False}.get(text, text)
