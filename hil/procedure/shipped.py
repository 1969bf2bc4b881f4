"""The shipped procedures: their names and summaries, read from their sources without running them."""

import ast
import pkgutil
from pathlib import Path

import hil

SHIPPED_FOLDER = (Path(hil.__file__).resolve().parent / "procedures").resolve()
"""Folder of the shipped procedures: in a checkout `procedures/`, to which `hil/procedures` is a link."""


def shipped_names() -> tuple[str, ...]:
    """Return the names of the shipped procedures: scripts, and packages."""
    return tuple(sorted(m.name for m in pkgutil.iter_modules([str(SHIPPED_FOLDER)])))


def shipped_summaries() -> dict[str, str]:
    """Return the names with the first lines of the docstrings of their `@procedure` functions."""
    return {name: _summary(name) for name in shipped_names()}


def _summary(name: str) -> str:
    folder = SHIPPED_FOLDER / name
    path = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
    functions = (part for part in ast.parse(path.read_bytes()).body if isinstance(part, ast.FunctionDef))
    for function in functions:
        if any(ast.unparse(d).startswith("procedure(") for d in function.decorator_list):
            return (ast.get_docstring(function) or "").partition("\n")[0]
    return ""
