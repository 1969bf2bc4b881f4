"""Classes and functions of the user's own, named on a command line: `FILE.py:NAME` or `MODULE:NAME`."""

import importlib
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, cast

from hil.core.errors import ConfigError, did_you_mean, shown_path
from hil.core.third_party_errors import of_a_script
from hil.user_code.script_file import look_for_modules_in, run_file

Parts = Sequence[str] | Mapping[str, Sequence[str]]
"""Methods that something made must have; a mapping gives the names of the arguments each is called with."""


def maker_of(named: str, option: str, parts: Parts) -> Callable[..., Any]:
    """The class or function that is named.

    Args:
        named: `FILE.py:NAME`; or `MODULE:NAME`, of an installed module or one in the current folder.
        option: option by which it was named, for errors.
        parts: methods that what it makes must have; classes that have them are offered for a wrong name,
            and so are functions.

    Raises:
        ConfigError: no such file, module or name, a file or module that fails, or a class or function that
            cannot be called as it will be.
    """
    stem, in_file, name = named.partition(".py:")
    if in_file:
        module = _of_file(Path(f"{stem}.py"), f"{option} {named}")
    else:
        package, _, name = named.partition(":")
        module = _of_package(package, f"{option} {named}")
    make = getattr(module, name, None)
    if callable(make):
        _check_making(make, f"{option} {named}")
        if inspect.isclass(make):
            _check_calls(make, parts, f"{option} {named}", bound=False)
        return cast("Callable[..., Any]", make)
    there = [*_classes_with(module, parts), *_functions_of(module)]
    raise ConfigError(
        f"{option} {named}: the {'file' if in_file else 'module'} has no class or function {name!r}",
        expected="one of " + ", ".join(there) if there else f"a class with {' and '.join(parts)}",
        remedy=did_you_mean(name, there),
    )


def make_named(named: str, option: str, parts: Parts, given: object, *, expected: str) -> Any:
    """What a named class or function makes: called with `given` if it takes an argument, else with none.

    Args:
        named: `FILE.py:NAME` or `MODULE:NAME`, as of `maker_of`.
        option: option by which it was named, for errors.
        parts: methods that the result must have.
        given: the argument.
        expected: description of its methods, for errors.

    Raises:
        ConfigError: the name is refused by `maker_of`, or it fails, or what it makes lacks a method, or has
            one that cannot be called as it will be.
    """
    make = maker_of(named, option, parts)
    _, _, name = named.rpartition(":")
    with of_a_script(f"{option} {named}: {name}()"):
        made = make(given) if _needed(make) else make()
    missing = [part for part in parts if not callable(getattr(made, part, None))]
    if missing:
        raise ConfigError(
            f"{option} {named}: what {name}() makes has no {' and no '.join(missing)}", expected=expected
        )
    _check_calls(made, parts, f"{option} {named}", bound=True)
    return made


def _classes_with(module: ModuleType, parts: Parts) -> Iterator[str]:
    """Names of the classes in a module that have all parts."""
    for name, value in vars(module).items():
        if inspect.isclass(value) and all(callable(getattr(value, part, None)) for part in parts):
            yield name


def _functions_of(module: ModuleType) -> Iterator[str]:
    """Names of the public functions that a module defines itself and that may be called with one argument."""
    for name, value in vars(module).items():
        own = isinstance(value, FunctionType) and value.__module__ == module.__name__
        if own and not name.startswith("_") and len(_needed(value)) <= 1:
            yield name


def _check_making(make: Callable[..., Any], given: str) -> None:
    """Refuse a class or function that needs more than one argument, or one by name."""
    if needed := _needed(make)[1:] or _needed_by_name(make):
        raise ConfigError(
            f"{given}: {_name_of(make)}{_signature(make)} also needs {', '.join(needed)}{_where(make)}",
            expected="no argument, or one, the bench's model",
            remedy="give the others default values, or take them from the bench",
        )


def _check_calls(part_of: Any, parts: Parts, given: str, *, bound: bool) -> None:
    """Refuse a method that does not take the arguments it is called with.

    Args:
        part_of: a class, or an object; of a class only plain methods are looked at.
        parts: methods with their arguments; without those nothing is checked.
        given: option and name, for errors.
        bound: True for an object, False for a class.
    """
    for part, arguments in parts.items() if isinstance(parts, Mapping) else ():
        method = getattr(part_of, part) if bound else inspect.getattr_static(part_of, part, None)
        if not bound and not isinstance(method, FunctionType):
            continue
        signature = _signature(method)
        try:
            if signature is not None:
                signature.bind(*([None] * (not bound)), *arguments)
        except TypeError:
            raise ConfigError(
                f"{given}: {part}{signature} cannot be called as {part}({', '.join(arguments)})"
                f"{_where(method)}",
                remedy=f"define {part}({', '.join(['self', *arguments])})",
            ) from None


def _signature(function: Callable[..., Any]) -> inspect.Signature | None:
    """Parameters of a function, None where they are not known (written in C)."""
    try:
        return inspect.signature(function)
    except (ValueError, TypeError):
        return None


def _name_of(make: Callable[..., Any]) -> str:
    return str(getattr(make, "__name__", type(make).__name__))


def _where(function: Callable[..., Any]) -> str:
    """File and line of a function or of a class's `__init__`, in words; empty where they are not known."""
    found = function.__init__ if inspect.isclass(function) else function
    code = getattr(getattr(found, "__func__", found), "__code__", None)
    return f" ({shown_path(Path(code.co_filename))}, line {code.co_firstlineno})" if code else ""


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


def _needed(make: Callable[..., Any]) -> list[str]:
    """Names of the positional arguments without which a call fails."""
    by_place = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return _without_default(make, by_place)


def _needed_by_name(make: Callable[..., Any]) -> list[str]:
    """Names of the keyword-only arguments without which a call fails."""
    return _without_default(make, (inspect.Parameter.KEYWORD_ONLY,))


def _without_default(make: Callable[..., Any], kinds: Sequence[Any]) -> list[str]:
    signature = _signature(make)
    taken = () if signature is None else signature.parameters.values()
    return [one.name for one in taken if one.kind in kinds and one.default is one.empty]
