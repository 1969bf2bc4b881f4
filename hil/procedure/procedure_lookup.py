"""Finds a procedure: a Python file anywhere, or the name of a shipped one."""

import importlib
import os
import sys
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from types import ModuleType

import hil
from hil.core.errors import ConfigError, did_you_mean, did_you_mean_file
from hil.core.path_hints import is_tests, meant
from hil.core.registry import kinds
from hil.procedure.declaration import Procedure
from hil.procedure.shipped import SHIPPED_FOLDER, shipped_names
from hil.support.atomic_files import check_name
from hil.user_code.script_file import run_file

SHIPPED = "hil.procedures"


def _shipped(name: str) -> ModuleType:
    return importlib.import_module(f"{SHIPPED}.{name}")


def file_and_name(script: str) -> tuple[str, str]:
    """Split `mine.py:name` into file and procedure name; the name is empty if not given."""
    file, _, name = script.partition(".py:")
    return (f"{file}.py", name) if name else (script, "")


def load_procedure(script: str) -> Procedure:
    """Load a procedure from a file (`path/to/mine.py`, `mine.py:name` for one of several) or by its name.

    Raises:
        ConfigError: no such file or name, the script fails, or it does not hold exactly one procedure.
        UsageError: the text is not a valid file name.
    """
    target, wanted = file_and_name(script)
    path = Path(target)
    check_name(path)
    if path.suffix == ".py":
        if not path.is_file():
            raise ConfigError(f"script {path}: no such file", expected=_known(), remedy=_near(str(path)))
        module = _from_file(path)
    elif target in shipped_names():
        module = _shipped(target)
    else:
        raise ConfigError(
            f"procedure {script!r} is unknown", expected=_known(), remedy=meant(path) or _near(target)
        )
    return _choose(module, wanted, script)


def _known() -> str:
    return "a path to a .py file, or one of " + ", ".join(shipped_names())


def _near(target: str) -> str:
    """Return a suggestion: a shipped procedure, or a script in the folder that was searched."""
    folder = Path(target).parent
    with suppress(OSError):
        scripts = [str(folder / found.name) for found in folder.glob("*.py") if found.is_file()]
        return did_you_mean_file(target, [*shipped_names(), *scripts])
    return did_you_mean_file(target, shipped_names())


def _from_file(path: Path) -> ModuleType:
    found = path.resolve()
    if found.parent == SHIPPED_FOLDER:
        return _shipped(found.stem)
    if found.parent.parent == SHIPPED_FOLDER:  # a part of a procedure that is a package
        return _shipped(found.parent.name)
    kinds()  # fail here if a device package cannot be used, so that the script is not reported
    return run_file(path)


_real = lru_cache(maxsize=None)(os.path.realpath)  # called repeatedly for thousands of modules


def modules_beside(script: Path) -> tuple[Path, ...]:
    """Return files and folders beside a script from which modules were imported; no installed packages."""
    itself, package = script.resolve(), Path(hil.__file__).resolve().parent
    folder, found = itself.parent, set()
    installed = [Path(sys.prefix).resolve(), Path(sys.base_prefix).resolve(), package, SHIPPED_FOLDER]
    for module in tuple(sys.modules.values()):
        file = getattr(module, "__file__", None)
        if not file or not _real(file).startswith(f"{folder}{os.sep}"):
            continue
        path = Path(_real(file))
        if path != itself and not any(place in path.parents for place in installed):
            found.add(folder / path.relative_to(folder).parts[0])
    return tuple(sorted(found))


def _choose(module: ModuleType, wanted: str, script: str) -> Procedure:
    found = {p.name: p for p in vars(module).values() if isinstance(p, Procedure)}
    if wanted and wanted not in found:
        raise ConfigError(
            f"{script}: declares no procedure {wanted!r}",
            expected=f"one of {', '.join(found)}" if found else "a function decorated with @procedure",
            remedy=did_you_mean(wanted, found),
        )
    if wanted:
        found = {wanted: found[wanted]}
    if not found and not wanted and is_tests(path := Path(script)):
        raise ConfigError(f"{script}: holds no procedure", remedy=meant(path))
    if len(found) != 1:
        raise ConfigError(
            f"{script}: declares {len(found)} procedures ({', '.join(found) or 'none'})",
            expected="one function decorated with @procedure, or FILE.py:NAME",
        )
    return next(iter(found.values()))
