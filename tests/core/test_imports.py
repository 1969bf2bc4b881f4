"""Kinds of devices are named in one place, and drivers and fakes are reached through the registry."""

import ast
from pathlib import Path

from hil.vocabulary.signals import KINDS

ROOT = Path(__file__).resolve().parents[2]
KNOWING = ("hil.bench", "hil.devices", "hil.devkit")
DEVICES = ("hil.drivers", "hil.fakes")
VOCABULARY = Path("hil/vocabulary/signals.py")
ACCUSING = ("hil/vocabulary/suspects.py", "hil/procedure/faults/bounds.py")
"""They say which kinds of devices a stop accuses, and which faults are of which class."""


def sources():
    found = [*(ROOT / "hil").rglob("*.py")]
    assert len(found) > 200
    return found


def imported(path):
    """Dotted names of all modules that a file imports, anywhere in it."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def named(path):
    """Kinds of devices that a file names: as a text, an attribute, an argument or a field."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant):
            yield node.value
        elif isinstance(node, ast.Attribute):
            yield node.attr
        elif isinstance(node, ast.keyword):
            yield node.arg
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            yield node.target.id


def test_only_registry_bench_and_devkit_know_drivers_and_fakes():
    guilty = [
        f"{path.relative_to(ROOT)} imports {name}"
        for path in sources()
        if ".".join(path.relative_to(ROOT).parts[:2])
        not in ("hil.bench", "hil.devices", "hil.devkit", *DEVICES)
        for name in imported(path)
        if f"{name}.".startswith(tuple(f"{d}." for d in DEVICES))
    ]
    assert guilty == []


def test_one_module_names_four_kinds_of_devices():
    many = {str(path.relative_to(ROOT)): sorted(set(named(path)) & set(KINDS)) for path in sources()}
    assert {name for name, kinds in many.items() if len(kinds) >= 4} == {str(VOCABULARY), *ACCUSING}
