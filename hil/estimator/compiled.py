"""`compiled`: numba's compiler where it is installed, the plain function where it is not.

The kernels are numpy code that runs either way with the same results (tests compare both). Nothing is
compiled until the first call; the machine code is cached beside the sources or in the user's cache.
numba keeps a function's code until that function's own file changes, although the code of every kernel
that it calls is inside: here its name in the cache carries a fingerprint of every file that it uses.
"""

from __future__ import annotations

import ast
import hashlib
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])

try:
    import numba
except ImportError:
    numba = None

AVAILABLE = numba is not None


def compiled(function: F) -> F:
    """Compile a kernel for its first argument types, with a cache where one can be written.

    The cache is named after the function's qualified name, which carries the fingerprint meanwhile.
    """
    if numba is None:
        return function
    name = function.__qualname__
    try:
        function.__qualname__ = f"{name}_{fingerprint(function.__module__)}"
        return cast(F, numba.njit(cache=True)(function))
    except (RuntimeError, OSError):  # nowhere to write the cache, or no sources to tell it from an older one
        return cast(F, numba.njit(function))
    finally:
        function.__qualname__ = name


def plain(function: F) -> F:
    """The uncompiled form of a kernel, for comparing both."""
    return cast(F, getattr(function, "py_func", function))


@cache
def fingerprint(module: str) -> str:
    """Short hash of all that a module's kernels are made of.

    Raises:
        OSError: a source cannot be read.
    """
    digest = hashlib.sha256()
    for path in sorted(sources(module).values()):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def sources(module: str) -> dict[str, Path]:
    """Module names to files: the module, and all of its package and of ours that it uses, however imported.

    What only annotations name is not used: no kernel is made of it.

    Args:
        module: dotted name; its top-level package is loaded.
    """
    folders = {top: _folder(top) for top in (module.partition(".")[0], "hil")}
    found: dict[str, Path] = {}
    left: list[tuple[str, ...]] = [(module,)]
    while left:
        for name in left.pop():
            path = _file(name, folders.get(name.partition(".")[0]))
            if path is not None:
                if name not in found:
                    found[name] = path
                    left += _uses(path, name)
                break
    return found


def _folder(top: str) -> Path | None:
    """Where a loaded top-level package or module lies."""
    file = getattr(sys.modules.get(top), "__file__", None)
    if file is None:
        return None
    return Path(file).parents[1] if Path(file).name == "__init__.py" else Path(file).parent


def _file(name: str, folder: Path | None) -> Path | None:
    """Source of a module below the folder of its top-level package; None for what is no module there."""
    if folder is None:
        return None
    path = folder.joinpath(*name.split("."))
    candidates = (path.with_suffix(".py"), path / "__init__.py")
    return next((p for p in candidates if p.is_file()), None)


@cache
def _uses(path: Path, name: str) -> tuple[tuple[str, ...], ...]:
    """Modules that a source file uses, each by the names that it may have."""
    used: set[str] = set()
    hints: set[str] = set()
    imports = []
    for node, in_annotation in _nodes(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Name):
            (hints if in_annotation else used).add(node.id)
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            imports.append(node)
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    bindings = (binding for node in imports for binding in _bindings(node, package))
    return tuple(modules for bound, modules in bindings if bound not in hints - used)


def _nodes(tree: ast.AST) -> Iterator[tuple[ast.AST, bool]]:
    """Every node, and whether it is part of an annotation."""
    left = [(tree, False)]
    while left:
        node, in_annotation = left.pop()
        yield node, in_annotation
        for field in node._fields:
            value = getattr(node, field, None)
            inner = value if isinstance(value, list) else (value,)
            within = in_annotation or field in ("annotation", "returns")
            left += [(n, within) for n in inner if isinstance(n, ast.AST) and field != "ctx"]


def _bindings(node: ast.Import | ast.ImportFrom, package: str) -> Iterator[tuple[str, tuple[str, ...]]]:
    """(name that is bound, modules that it may come from) of an import."""
    if isinstance(node, ast.Import):
        for alias in node.names:
            yield alias.asname or alias.name.partition(".")[0], (alias.name,)
        return
    parents = package.split(".")
    above = parents[: len(parents) - node.level + 1] if node.level else []
    base = ".".join([*above, *([node.module] if node.module else [])])
    for alias in node.names:
        yield alias.asname or alias.name, (f"{base}.{alias.name}", base)
