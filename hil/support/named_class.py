"""Classes and functions of the user's own, named on a command line: `FILE.py:NAME` or `MODULE:NAME`."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from hil.core.errors import ConfigError, did_you_mean
from hil.core.package_errors import of_a_script
from hil.support.script_file import look_for_modules_in, run_file


def maker_of(named: str, option: str, parts: Sequence[str]) -> Callable[..., Any]:
    """The class or function that is named.

    Args:
        named: `FILE.py:NAME`; or `MODULE:NAME`, of an installed module or one in the current folder.
        option: by which it was named, for errors.
        parts: methods that what it makes must have; classes that have them are offered for a wrong name.

    Raises:
        ConfigError: no such file, module or name, or a file or module that fails.
    """
    stem, in_file, name = named.partition(".py:")
    if in_file:
        module = _of_file(Path(f"{stem}.py"), f"{option} {named}")
    else:
        package, _, name = named.partition(":")
        module = _of_package(package, f"{option} {named}")
    make = getattr(module, name, None)
    if callable(make):
        return cast("Callable[..., Any]", make)
    there = [
        key
        for key, value in vars(module).items()
        if inspect.isclass(value) and all(callable(getattr(value, part, None)) for part in parts)
    ]
    raise ConfigError(
        f"{option} {named}: the {'file' if in_file else 'module'} has no class or function {name!r}",
        expected="one of " + ", ".join(there) if there else f"a class with {' and '.join(parts)}",
        remedy=did_you_mean(name, there),
    )


def make_named(named: str, option: str, parts: Sequence[str], given: object, *, expected: str) -> Any:
    """What a named class or function makes: called with `given` if it takes an argument, else with none.

    Args:
        named: as `maker_of`.
        option: as `maker_of`.
        parts: as `maker_of`.
        given: the argument.
        expected: what its methods are, in words, for errors.

    Raises:
        ConfigError: as `maker_of`; or it fails, or what it makes lacks a method.
    """
    make = maker_of(named, option, parts)
    _, _, name = named.rpartition(":")
    with of_a_script(f"{option} {named}: {name}()"):
        made = make(given) if _needs_one(make) else make()
    missing = [part for part in parts if not callable(getattr(made, part, None))]
    if missing:
        raise ConfigError(
            f"{option} {named}: what {name}() makes has no {' and no '.join(missing)}", expected=expected
        )
    return made


def _of_file(path: Path, given: str) -> ModuleType:
    if not path.is_file():
        raise ConfigError(f"{given}: {path}: no such file", expected="a Python file")
    return run_file(path)


def _of_package(name: str, given: str) -> ModuleType:
    here = Path.cwd()
    look_for_modules_in(str(here))
    with of_a_script(f"{given}: import {name}"):
        try:
            return importlib.import_module(name)
        except ModuleNotFoundError as error:
            if error.name is None or not f"{name}.".startswith(f"{error.name}."):
                raise
        except ValueError:  # an empty name
            pass
    raise ConfigError(
        f"{given}: no module {name!r}",
        expected=f"one in {here}, or an installed one",
        remedy="or name a file: FILE.py:NAME",
    )


def _needs_one(make: Callable[..., Any]) -> bool:
    """Whether a call needs a positional argument."""
    by_place = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    taken = inspect.signature(make).parameters.values()
    return any(one.kind in by_place and one.default is one.empty for one in taken)
