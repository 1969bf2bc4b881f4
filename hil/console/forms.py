"""Commands and procedures as forms of the console: fields from click's options and from typed parameters."""

import importlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from hil.config.loading import NoSuchDevice, load_bench
from hil.config.shipped_profiles import profile_names
from hil.console.command_forms import Action, Field, Values
from hil.core.errors import ConfigError, HilError
from hil.core.signals import WHEELS
from hil.procedure.declaration import Procedure
from hil.procedure.parameters import Described, described, make_parameters, written
from hil.procedure.procedure_lookup import load_procedure
from hil.procedure.shipped import shipped_names

_OFFERED = {
    "doctor": ("devices", "Examine the devices", ("--bench", "--emulate")),
    "accept": ("whole benches", "The first day", ("--bench", "--on-stand")),
    "commission": ("whole benches", "All procedures in order", ("--bench", "--quick")),
    "live": ("live", "Watch the live loop", ("--bench", "--duration")),
    "jog": ("live", "Move the robot by hand", ("--bench",)),
}
"""Commands that the console starts: heading, and which of their options are seen at first."""
_TERMINAL = {"answers", "fix", "dry", "resume", "commands", "script", "settings", "gamepad"}
_NEVER = {"as_json", "out", "record", "unrecorded"} | _TERMINAL
"""Options that the console sets itself, or that belong to a terminal."""
_SEEN = ("--bench", "--quick")
_UNITS = {
    "m_s": "m/s",
    "rad_s": "rad/s",
    "rad": "rad",
    "deg": "deg",
    "mm": "mm",
    "ms": "ms",
    "m": "m",
    "s": "s",
    "hz": "Hz",
    "n": "N",
}
_BENCH, _EMULATE, _SET, _MOVES = "--bench", "--emulate", "--set", "moves"


def actions(root: Path) -> list[Action]:
    """Everything that can be started from the console.

    Args:
        root: folder of results.
    """
    run = _command("run")
    procedures = [_procedure(load_procedure(name), run, root) for name in shipped_names()]
    commands = [_jog(root) if name == "jog" else _plain(name, root) for name in _OFFERED]
    return [*commands, *procedures, _script(run, root)]


def _command(name: str) -> click.Command:
    found = importlib.import_module(f"hil.cli.{name}").command
    assert isinstance(found, click.Command)
    return found


def benches() -> tuple[str, ...]:
    """Bench files of this folder, then the shipped profiles."""
    return (*sorted(_bench_files()), *profile_names())


def _bench_files() -> Iterator[str]:
    for path in Path().glob("*.toml"):
        try:
            head = path.read_text(encoding="utf-8")
        except (OSError, ValueError):
            continue
        if any(line.strip().startswith("[servos") or line.startswith("schema") for line in head.splitlines()):
            yield path.name


def _plain(name: str, root: Path) -> Action:
    group, title, seen = _OFFERED[name]
    command = _command(name)

    def words(values: Values) -> tuple[str, ...]:
        return (name, *_options(command, values), *_where(name, name, root), "--json")

    def problems(values: Values) -> dict[str, str]:
        return _problems_of_options(command, name, _options(command, values)) | _problems_of_bench(values)

    return Action(name, group, title, tuple(_fields(command, seen)), words, problems)


def _jog(root: Path) -> Action:
    """Form of `hil jog`: one choice of what is moved, in place of three options that exclude each other."""
    plain = _plain("jog", root)
    moved = {f"wheel {name}": {"--wheel": name} for name in WHEELS}
    moved |= {f"steer {name}": {"--steer": name} for name in WHEELS} | {"body": {"--body": "true"}}
    what = Field(_MOVES, "moves", "choice", help="What the buttons move.", choices=tuple(moved))
    bench, *rest = (field for field in plain.fields if field.name not in ("--wheel", "--steer", "--body"))

    def as_options(values: Values) -> Values:
        kept = {key: value for key, value in values.items() if key != _MOVES}
        return kept | moved.get(values.get(_MOVES, ""), {})

    def problems(values: Values) -> dict[str, str]:
        if values.get(_MOVES) not in moved:
            return {_MOVES: "choose what the buttons move: a wheel, a steering axis, or the body"}
        return plain.problems(as_options(values))

    def words(values: Values) -> tuple[str, ...]:
        return plain.words(as_options(values))

    return Action(plain.name, plain.group, plain.summary, (bench, what, *rest), words, problems)


def _procedure(proc: Procedure, run: click.Command, root: Path) -> Action:
    parameters = {d.name: _parameter(d, proc) for d in described(proc.parameters)}
    options = [f for f in _fields(run, _SEEN) if f.name != "--quick" or proc.quick]

    def words(values: Values) -> tuple[str, ...]:
        given = [part for key in parameters if key in values for part in (_SET, f"{key}={values[key]}")]
        return ("run", proc.name, *_options(run, values), *given, *_where("run", proc.name, root), "--json")

    def problems(values: Values) -> dict[str, str]:
        found = _problems_of_options(run, "run", [proc.name, *_options(run, values)])
        given = {key: values[key] for key in parameters if key in values}
        found |= _problems_of_bench(values)
        return found | _problems_of_parameters(proc, given, quick="--quick" in values)

    fields = sorted((*options, *parameters.values()), key=lambda f: f.more)
    return Action(proc.name, "procedures", proc.summary, tuple(fields), words, problems)


def _script(run: click.Command, root: Path) -> Action:
    """Form that runs a procedure of the user's own."""

    def words(values: Values) -> tuple[str, ...]:
        given = [part for text in values.get(_SET, "").split() for part in (_SET, text)]
        name = Path(values.get("SCRIPT", "")).stem or "script"
        script = values.get("SCRIPT", "")
        return ("run", *_options(run, values), *given, *_where("run", name, root), "--json", "--", script)

    def problems(values: Values) -> dict[str, str]:
        script = values.get("SCRIPT", "")
        if not script:
            return {"SCRIPT": "which file?"}
        try:
            load_procedure(script)
        except HilError as error:
            return {"SCRIPT": str(error)}
        words = [*_options(run, values), "--", script]
        return _problems_of_options(run, "run", words) | _problems_of_bench(values)

    own = (
        Field(
            "SCRIPT",
            "script",
            "text",
            help="Python file with a procedure.",
            choices=tuple(sorted(map(str, Path().glob("*.py")))),
        ),
        Field(_SET, _title(_SET), "text", help="Its parameters, KEY=VALUE, separated by spaces."),
    )
    fields = (*own, *sorted(_fields(run, _SEEN), key=lambda f: f.more))
    return Action(
        "a procedure of your own", "procedures", "Run a Python file of yours.", fields, words, problems
    )


def _where(command: str, name: str, root: Path) -> Sequence[str]:
    """Options for the output of a run, and for questions that the console answers on stdin."""
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S-%f")[:-3]
    if command in ("live", "jog"):
        return "--out", str(root / "live" / stamp)
    return () if command == "doctor" else ("--out", str(root / name / stamp), "--answers", "-")


def _fields(command: click.Command, seen: Sequence[str]) -> Iterator[Field]:
    for option in command.params:
        if isinstance(option, click.Option) and option.name not in _NEVER and not option.hidden:
            yield _field(option, more=option.opts[-1] not in seen)


def _field(option: click.Option, *, more: bool) -> Field:
    kind, default = option.type, option.default
    known = str(default) if isinstance(default, (str, int, float)) else ""
    name = option.opts[-1]
    plain = Field(name, _title(name), "text", known, _on_a_page(option.help or ""), more=more)
    if option.is_flag:
        return replace(plain, kind="flag", default="")
    if isinstance(kind, click.Choice) and not option.multiple:
        return replace(plain, kind="choice", choices=tuple(map(str, kind.choices)))
    if isinstance(kind, (click.IntRange, click.FloatRange)):
        return replace(
            plain,
            kind="integer" if isinstance(kind, click.IntRange) else "number",
            unit=_unit(option.name or ""),
            low=kind.min,
            high=kind.max,
            low_open=kind.min_open,
        )
    return replace(plain, choices=benches() if plain.name == _BENCH else ())


def _on_a_page(text: str) -> str:
    """Help of an option without its default, which the field shows, and without parts that name options."""
    parts = [part for part in text.split(" [default")[0].split("; ") if "--" not in part]
    return "; ".join(parts).rstrip(".") + "." * bool(parts)


def _parameter(d: Described, proc: Procedure) -> Field:
    quick = f"Quick form: {written(proc.quick[d.name])}." if d.name in proc.quick else ""
    listed = f"Some of {', '.join(d.choices)}, with commas." if d.kind == "array" and d.choices else ""
    message = " ".join(filter(None, (d.help, listed, quick)))
    plain = Field(
        d.name, _title(d.name), "text", d.default, message, _unit(d.name), d.low, d.high, d.low_open
    )
    if d.kind == "boolean":
        return replace(plain, kind="choice", choices=("true", "false"))
    if d.kind == "string" and d.choices:
        return replace(plain, kind="choice", choices=d.choices)
    if d.kind in ("integer", "number"):
        return replace(plain, kind="integer" if d.kind == "integer" else "number")
    return plain


def _suffix(name: str) -> str:
    return next((suffix for suffix in _UNITS if name.endswith(f"_{suffix}")), "")


def _unit(name: str) -> str:
    return _UNITS.get(_suffix(name), "")


def _title(name: str) -> str:
    """The name without its unit, which stands beside the field."""
    suffix = _suffix(name)
    return (name[: -len(suffix)] if suffix else name).strip("-_").replace("-", " ").replace("_", " ")


def _options(command: click.Command, values: Values) -> list[str]:
    """Command-line words of filled-in values; several values of one option are separated by spaces."""
    words = []
    for option in command.params:
        if not isinstance(option, click.Option) or option.opts[-1] not in values:
            continue
        name, value = option.opts[-1], values[option.opts[-1]]
        if option.name in _NEVER:
            continue
        if option.is_flag:
            words += [name] if value == "true" else []
        else:
            words += [f"{name}={part}" for part in (value.split() if option.multiple else (value,))]
    return words


def _problems_of_options(command: click.Command, name: str, words: Iterable[str]) -> dict[str, str]:
    """Errors that click finds in the words, by field; the command does not run, no device is opened."""
    try:
        command.make_context(name, list(words))
    except click.UsageError as error:
        option = getattr(error, "param", None)
        field = option.opts[-1] if isinstance(option, click.Option) else ""
        return {field: error.message}
    except HilError as error:
        return {"": str(error)}
    return {}


def _problems_of_bench(values: Values) -> dict[str, str]:
    """Errors in the named bench file and in the list of its devices to emulate, by field."""
    if _BENCH not in values:
        return {}
    try:
        load_bench(values[_BENCH], emulate=values.get(_EMULATE))
    except NoSuchDevice as error:
        return {_EMULATE: str(error)}
    except HilError as error:
        return {_BENCH: str(error)}
    return {}


def _problems_of_parameters(proc: Procedure, given: dict[str, Any], *, quick: bool) -> dict[str, str]:
    try:
        make_parameters(proc.parameters, proc.settings(given, quick=quick), proc.name)
    except ConfigError as error:
        pairs = (text.partition(": ") for text in error.problems)
        return {key if key in given else "": text for key, _, text in pairs}
    except HilError as error:
        return {"": str(error)}
    return {}
