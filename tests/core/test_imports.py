"""Drivers and fakes are reached through the bench: no other package imports them, for whatever reason."""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DEVICES = ("hil.drivers", "hil.fakes")


def imported(path):
    """Dotted names of all modules that a file imports, anywhere in it."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def package(path):
    """`hil.PACKAGE` of a source file."""
    *parts, _ = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:2])


def test_only_the_bench_knows_drivers_and_fakes():
    files = [*(ROOT / "hil").rglob("*.py"), *(ROOT / "procedures").rglob("*.py")]
    guilty = [
        f"{path.relative_to(ROOT)} imports {name}"
        for path in files
        if package(path) not in ("hil.bench", *DEVICES)
        for name in imported(path)
        if f"{name}.".startswith(tuple(f"{d}." for d in DEVICES))
    ]
    assert len(files) > 200
    assert guilty == []
