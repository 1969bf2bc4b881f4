"""Devices and faults as they are declared: from sources and a table, since importing them takes a second.

Device packages of others are not of this project: where one is installed the registry is asked, and it
imports all.
"""

import ast
import json
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, NamedTuple

import hil
from hil.core.call_chain import GROUP
from hil.core.known_names import KINDS

_PACKAGE = Path(hil.__file__).resolve().parent
FAULTS = _PACKAGE / "faults" / "of_the_emulated_bench.json"
"""Faults of the profile `emulated`; `docs/make_fault_reference.py` writes the table."""
TABLED = "emulated"


class DeclaredModel(NamedTuple):
    """A device model: its name, its title, and the package that it comes from."""

    name: str
    title: str
    package: str = "hil"


class DeclaredKind(NamedTuple):
    """A kind of devices: what one is called, and its models."""

    noun: str
    models: tuple[DeclaredModel, ...]


def devices() -> dict[str, DeclaredKind]:
    """All kinds by name, in the order in which they are opened and read.

    Raises:
        ConfigError: an installed package adds something that cannot be used.
    """
    if not entry_points(group=GROUP):
        return {name: _kind(name) for name in KINDS}
    from hil.core.registry import kinds

    return {
        kind.name: DeclaredKind(
            kind.noun, tuple(DeclaredModel(m.name, m.title, m.package) for m in kind.models)
        )
        for kind in kinds().values()
    }


def faults(bench: str) -> dict[str, dict[str, list[str]]]:
    """Faults of a bench whose devices are all emulated: by device and kind the options.

    Raises:
        ConfigError, UsageError: no such bench, or it cannot be used.
    """
    if bench == TABLED and not Path(bench).exists():
        found: dict[str, dict[str, list[str]]] = json.loads(FAULTS.read_text(encoding="utf-8"))
        return found
    from hil.bench.emulated_devices import supported_faults
    from hil.config.loading import load_bench

    declared = supported_faults(load_bench(bench, emulate="all"))
    return {name: {kind: list(o) for kind, o in faults.items()} for name, faults in declared.items()}


def _kind(name: str) -> DeclaredKind:
    """A shipped kind, from the class attributes in the sources of its package."""
    sources = (path.read_bytes() for path in sorted((_PACKAGE / "drivers" / name).rglob("*.py")))
    said = {
        part.name: dict(_attributes(part))
        for source in sources
        if b"title = " in source or b"noun, " in source
        for part in ast.parse(source).body
        if isinstance(part, ast.ClassDef)
    }
    kind = next(a for a in said.values() if {"name", "noun", "models"} <= a.keys())
    models = [said[call.func.id] for call in kind["models"].elts]
    return DeclaredKind(
        kind["noun"].value, tuple(DeclaredModel(m["name"].value, m["title"].value) for m in models)
    )


def _attributes(of: ast.ClassDef) -> Iterator[tuple[str, Any]]:
    """Names and values of the assignments in the body of a class: `a = 1`, and `a, b = 1, 2`."""
    for part in of.body:
        if isinstance(part, ast.Assign):
            for target in part.targets:
                if isinstance(target, ast.Name):
                    yield target.id, part.value
                elif isinstance(target, ast.Tuple) and isinstance(part.value, ast.Tuple):
                    names = [t.id for t in target.elts if isinstance(t, ast.Name)]
                    yield from zip(names, part.value.elts, strict=True)
