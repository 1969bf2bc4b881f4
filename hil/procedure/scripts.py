"""Finds a procedure: a Python file anywhere, or the name of a shipped one."""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
import sys
from pathlib import Path
from types import ModuleType

from hil.errors import ConfigError, HilError
from hil.procedure.declaration import Procedure

SHIPPED = "procedures"


def shipped_names() -> tuple[str, ...]:
    """Names of the procedures that come with the package."""
    spec = importlib.util.find_spec(SHIPPED)
    if spec is None or spec.submodule_search_locations is None:
        return ()
    found = pkgutil.iter_modules(list(spec.submodule_search_locations))
    return tuple(sorted(m.name for m in found if not m.name.startswith("_")))


def load_procedure(script: str) -> Procedure:
    """The procedure of a file (`path/to/mine.py`, `mine.py:name` for one of several) or of a name.

    Raises:
        ConfigError: no such file or name, a script that fails, or not exactly one procedure in it.
    """
    target, _, wanted = script.partition(".py:")
    path = Path(target + ".py" if wanted else target)
    if path.suffix == ".py":
        if not path.is_file():
            raise ConfigError(f"script {path}: no such file", expected=_known())
        module = _from_file(path)
    elif target in shipped_names():
        module = importlib.import_module(f"{SHIPPED}.{target}")
    else:
        raise ConfigError(f"procedure {script!r} is unknown", expected=_known())
    return _choose(module, wanted, script)


def _known() -> str:
    return "a path to a .py file, or one of " + ", ".join(shipped_names())


def _from_file(path: Path) -> ModuleType:
    for entry in map(Path, importlib.util.find_spec(SHIPPED).submodule_search_locations):  # type: ignore
        if path.resolve().parent == entry.resolve():
            return importlib.import_module(f"{SHIPPED}.{path.stem}")
    name = f"hil_script_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except HilError as error:
        raise ConfigError(f"{path}: {error}") from None
    except SyntaxError as error:
        raise ConfigError(f"{path}: line {error.lineno}: {error.msg}") from None
    except Exception as error:
        raise ConfigError(f"{path}: cannot be loaded ({type(error).__name__}: {error})") from error
    return module


def _choose(module: ModuleType, wanted: str, script: str) -> Procedure:
    found = {p.name: p for p in vars(module).values() if isinstance(p, Procedure)}
    if wanted:
        found = {n: p for n, p in found.items() if n == wanted}
    if len(found) != 1:
        raise ConfigError(
            f"{script}: declares {len(found)} procedures ({', '.join(found) or 'none'})",
            expected="one function decorated with @procedure, or FILE.py:NAME",
        )
    return next(iter(found.values()))
