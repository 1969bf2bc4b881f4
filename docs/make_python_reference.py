"""Writes `api.md`, the public classes and functions of the package, from their docstrings."""

from __future__ import annotations

import ast
import dataclasses
import enum
import importlib
import inspect
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from textwrap import dedent
from typing import Any

PAGE = Path(__file__).with_name("api.md")
HEAD = """# Python reference

The public classes and functions of the package. Units are SI and part of the names. Poses are
`(x m, y m, heading rad)` in the frame of the wall. The wheel order is FL, BL, BR, FR everywhere.
Types stand as in the source: `Array` is a NumPy array of float64, `ArrayLike` is what NumPy makes one of,
`OnCycle` and `Until` are functions of a `CycleRecord`; `Until` returns True to end.
[What stays](compatibility.md) lists the modules that keep their names between versions.

This page is written by `docs/make_python_reference.py` from the docstrings.
"""
SECTIONS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("A bench", "", ("hil.open_bench", "hil.Bench", "hil.bench.hold.held_state.Held")),
    ("Motions", "", ("hil.robot.trajectories",)),
    (
        "Procedures",
        "",
        (
            "hil.procedure.procedure",
            "hil.procedure.Measurement",
            "hil.procedure.Context",
            "hil.procedure.BenchSource",
            "hil.procedure.PlannedStep",
            "hil.procedure.sample_arrays",
            "hil.procedure.scripted_joints",
            "hil.procedure.tracking_errors",
        ),
    ),
    ("Samples and states", "", ("hil.core.signals",)),
    (
        "Seams",
        "",
        (
            "hil.core.interfaces",
            "hil.core.device",
            "hil.streams.streaming_sensor",
            "hil.streams.serial_sensor",
            "hil.streams.can_sensor",
            "hil.fakes.streaming_chip",
        ),
    ),
    (
        "The decision of a cycle",
        "[How to run your own controller or estimator](pytest.md#your-own-controller-or-estimator).",
        ("hil.loop.pipeline.ControlPipeline", "hil.loop.pipeline.Decision"),
    ),
    (
        "Recordings",
        "[Your own estimator](estimation.md#your-own-estimator) shows a comparison on a recording.",
        (
            "hil.recording.runs.RunStart",
            "hil.recording.runs.RecordedRun",
            "hil.recording.runs.read_runs",
            "hil.replay.estimator_comparison.compare",
            "hil.replay.truth_errors.errors",
            "hil.replay.estimator_comparison.consistency",
        ),
    ),
    ("Time and errors", "", ("hil.core.clock", "hil.core.errors")),
)
_PART = re.compile(r"^(Args|Attributes|Returns|Yields|Raises):$", re.M)
_WIDTH = 100


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    for title, text, names in SECTIONS:
        parts.append(f"\n## {title}\n")
        parts += [f"\n{text}\n"] * bool(text)
        for name in names:
            parts += _entry(name)
    return "".join(parts)


def _entry(name: str) -> Iterator[str]:
    """A module with its members, a class with its own, or a function."""
    found = _object(name)
    if inspect.ismodule(found):
        yield f"\n### {name}\n\n{_text(found)}"
        for key, value in _members(found):
            yield from _described(f"{name}.{key}", value, 4)
        return
    yield from _described(name, found, 3)


def _object(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError:
        place, _, last = name.rpartition(".")
        return getattr(importlib.import_module(place), last)


def _members(module: Any) -> Iterator[tuple[str, Any]]:
    """Public classes and functions of a module in the order of its source."""
    listed = getattr(module, "__all__", None)
    for key, value in vars(module).items():
        documented = (inspect.isclass(value) or inspect.isfunction(value)) and value.__doc__
        here = key in listed if listed is not None else getattr(value, "__module__", "") == module.__name__
        if documented and here and not key.startswith("_"):
            yield key, value


def _described(name: str, value: Any, level: int) -> Iterator[str]:
    kind = "class " if inspect.isclass(value) else ""
    yield f"\n{'#' * level} {name.rpartition('.')[2]}\n\n```python\n{kind}{_signature(name, value)}\n```\n\n"
    yield _text(value)
    if not inspect.isclass(value):
        return
    fields = {f.name for f in dataclasses.fields(value)} if dataclasses.is_dataclass(value) else set()
    for key, member in _own(value):
        inner = member.fget if isinstance(member, property) else getattr(member, "__func__", member)
        if key in fields or not getattr(inner, "__doc__", None):
            continue
        shown = key if isinstance(member, property) else _signature(key, inner, bound=True)
        headed = f"```python\n{shown}\n```" if "\n" in shown else f"**`{shown}`**"
        yield f"\n{headed}\n\n{_text(inner)}"


def _own(value: type) -> Iterator[tuple[str, Any]]:
    """Public methods and properties of a class and of its bases in this package, each once."""
    seen: set[str] = set()
    for base in value.__mro__:
        if not base.__module__.startswith("hil") or issubclass(value, BaseException):
            continue
        for key, member in vars(base).items():
            plain = isinstance(member, (property, staticmethod, classmethod)) or inspect.isfunction(member)
            if plain and not key.startswith("_") and key not in seen:
                seen.add(key)
                yield key, member


def _signature(name: str, value: Any, *, bound: bool = False) -> str:
    """Name, parameters with their types and defaults, and what is returned; on one line where it fits."""
    if inspect.isclass(value) and issubclass(value, enum.Enum):
        return name
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):
        return name
    given = list(signature.parameters.values())[1 if bound and "self" in signature.parameters else 0 :]
    types = _written_types(value)
    shown = list(_parameters([p for p in given if p.name != "cls"], types))
    if shown == ["*args", "**kwargs"]:
        return name
    returns = "" if inspect.isclass(value) else f" -> {types.get('return', 'None')}"
    whole = f"{name}({', '.join(shown)}){returns}"
    if len(whole) <= _WIDTH:
        return whole
    lines = "".join(f"    {one},\n" for one in shown)
    return f"{name}(\n{lines}){returns}"


def _parameters(given: list[inspect.Parameter], types: Mapping[str, str]) -> Iterator[str]:
    """Parameters as text, with the mark before those that have to be named.

    Args:
        given: parameters of one signature.
        types: types by name of parameter, as text.
    """
    marked = False
    for one in given:
        if one.kind is one.KEYWORD_ONLY and not marked:
            yield "*"
        marked = marked or one.kind in (one.VAR_POSITIONAL, one.KEYWORD_ONLY)
        stars = {one.VAR_POSITIONAL: "*", one.VAR_KEYWORD: "**"}.get(one.kind, "")
        known = f": {types[one.name]}" if one.name in types else ""
        default = "" if one.default is one.empty else f" = {_default(one.default)}"
        yield f"{stars}{one.name}{known}{default}"


def _written_types(value: Any) -> dict[str, str]:
    """Types as the source writes them, by name of parameter or field, and `return`.

    Types at run time are printed differently by each release of Python and NumPy.
    """
    if not inspect.isclass(value):
        return _types_of_function(_source_tree(inspect.unwrap(value)))
    found: dict[str, str] = {}
    for base in reversed([b for b in value.__mro__ if b.__module__.startswith("hil")]):
        for part in _source_tree(base).body:
            if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name):
                found[part.target.id] = _type(part.annotation)
            elif isinstance(part, ast.FunctionDef) and part.name == "__init__":
                found.update(_types_of_function(part))
    return found


def _source_tree(value: Any) -> Any:
    """Syntax tree of one function or class."""
    return ast.parse(dedent(inspect.getsource(value))).body[0]


def _types_of_function(function: ast.FunctionDef) -> dict[str, str]:
    given = function.args
    every = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
    found = {one.arg: _type(one.annotation) for one in every if one and one.annotation}
    return {**found, **({"return": _type(function.returns)} if function.returns else {})}


def _type(annotation: ast.expr) -> str:
    """A type as text; a type written as a string without its quotes."""
    if isinstance(annotation, ast.Constant) and isinstance(annotation.value, str):
        return annotation.value
    return ast.unparse(annotation)


def _default(value: Any) -> str:
    if isinstance(value, enum.Enum):
        return f"{type(value).__name__}.{value.name}"
    if callable(value):
        return str(getattr(value, "__name__", type(value).__name__))
    return "..." if (text := repr(value)).startswith("<") else text


def _text(value: Any) -> str:
    """A docstring in Markdown: its text, then its entries as lists."""
    pieces = _PART.split(inspect.cleandoc(value.__doc__ or ""))
    lines = [pieces[0].strip()]
    for head, body in zip(pieces[1::2], pieces[2::2], strict=True):
        content = dedent(body).strip("\n")
        if head in ("Returns", "Yields"):
            lines.append(f"*{head}:* {content}")
            continue
        entries, _, rest = content.partition("\n\n")
        said = re.sub(r"^(?=\S)([^:\n]+):", r"* `\1`:", entries, flags=re.M)
        said = re.sub(r"^    ", "  ", said, flags=re.M)
        lines += [f"*{head}:*", said, *filter(None, [rest])]
    return "\n\n".join(filter(None, lines)) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
