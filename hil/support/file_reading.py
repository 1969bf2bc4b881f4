"""Reads small files whole: bounded, with an error that names the file.

A file may come from anywhere. What is read here costs bounded memory and time whatever is in it: size,
depth of nesting and length of keys are limited, and a parser's own failures become one `ValueError`.
"""

import errno
import json
import re
import stat
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hil.core.errors import ConfigError, DataError, reason_of

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MOST_TOML_BYTES = 4 << 20
MOST_JSON_BYTES = 64 << 20
_PIECE = 1 << 20
_DEEPEST = 64
_KEY = r"""(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')"""
_LONG_KEY = re.compile(rf"(?<![A-Za-z0-9_-])(?:{_KEY}[ \t]*\.[ \t]*){{{_DEEPEST}}}")
_BYTE_ORDER_MARK = "\ufeff"
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")


def read_text(path: Path, most_bytes: int) -> str:
    """Content of a UTF-8 file.

    Raises:
        OSError: it cannot be read, or is no file.
        ValueError: it is larger than `most_bytes`, or not UTF-8.
    """
    return read_bytes(path, most_bytes).decode("utf-8")


def read_bytes(path: Path, most_bytes: int) -> bytes:
    """Content of a file.

    Raises:
        OSError: it cannot be read, or is no file.
        ValueError: it is larger than `most_bytes`.
    """
    must_be_file(path)
    found = bytearray()
    with path.open("rb") as file:
        while piece := file.read(_PIECE):
            found += piece
            if len(found) > most_bytes:
                raise ValueError(f"larger than {most_bytes / (1 << 20):g} MiB")
    return bytes(found)


def must_be_file(path: Path) -> None:
    """Refuse a pipe, a socket or a device before it is opened: it may let a reader wait for ever.

    Raises:
        OSError: it is no regular file, or does not exist; a folder fails only when it is opened.
    """
    if not path.is_dir() and not stat.S_ISREG(path.stat().st_mode):
        raise OSError(errno.EINVAL, "a pipe, socket or device, not a file")


def read_toml(path: Path, *, remedy: str = "") -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        ConfigError: it cannot be read or is not TOML; `remedy` says what to do where it cannot be read.
    """
    try:
        text = read_text(path, MOST_TOML_BYTES)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be read ({reason_of(error)})", remedy=remedy) from None
    return toml_tables(text, str(path))


def toml_tables(text: str, origin: str) -> dict[str, Any]:
    """The tables of a TOML text; it may begin with a byte order mark, as some editors of Windows write it.

    Raises:
        ConfigError: not TOML, or nested deeper than any file of this project; names `origin`.
    """
    try:
        if _LONG_KEY.search(text) is not None:
            raise ValueError(f"a key of more than {_DEEPEST} parts")
        tree = tomllib.loads(text.removeprefix(_BYTE_ORDER_MARK))
        _check_depth(tree)
    except RecursionError:
        raise ConfigError(f"{origin}: not valid TOML (nested too deeply)") from None
    except ValueError as error:
        raise ConfigError(f"{origin}: not valid TOML ({error})") from None
    return tree


def read_json(path: Path, *, remedy: str = "") -> Any:
    """The value of a JSON file.

    Raises:
        DataError: it cannot be read or is not JSON; `remedy` says what to do where it cannot be read.
    """
    try:
        text = read_text(path, MOST_JSON_BYTES)
    except (OSError, ValueError) as error:
        raise DataError(str(path), f"cannot be read ({reason_of(error)})", remedy=remedy) from None
    try:
        return json_value(text)
    except ValueError as error:
        raise DataError(str(path), f"is not JSON ({error})") from None


def json_value(text: str | bytes) -> Any:
    """The value of a JSON text; raises `ValueError`, and nothing else, for one that is not usable."""
    try:
        tree = json.loads(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    _check_depth(tree)
    return tree


def json_object(text: str | bytes) -> dict[str, Any]:
    """The value as of `json_value`, for a text that has to be an object.

    Raises:
        ValueError: it is no JSON, or no object.
    """
    tree = json_value(text)
    if not isinstance(tree, dict):
        raise ValueError(f"a JSON object was expected, found {type(tree).__name__}")
    return tree


def _check_depth(tree: Any) -> None:
    level = [tree]
    for _ in range(_DEEPEST):
        level = [inner for outer in level for inner in _inside(outer)]
        if not level:
            return
    raise ValueError(f"nested deeper than {_DEEPEST} levels")


def _inside(tree: Any) -> list[Any]:
    values = tree.values() if isinstance(tree, dict) else tree if isinstance(tree, list) else ()
    return [value for value in values if isinstance(value, (dict, list))]


def dotted(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Values of a tree of tables by their dotted keys, in the tree's order."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from dotted(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


def get_dotted(tree: Mapping[str, Any], key: str) -> object:
    """The value of a dotted key in a tree of tables, None without one; an empty key gives the whole tree."""
    found: Any = tree
    for name in filter(None, key.split(".")):
        found = found.get(name) if isinstance(found, Mapping) else None
    return found


def put_dotted(tree: dict[str, Any], key: str, value: object, whose: str) -> None:
    """Put a value into a tree of tables by its dotted key; tables that are missing are made.

    Raises:
        ConfigError: there is a value where a table is needed; its message begins with `whose`.
    """
    *tables, last = key.split(".")
    for name in tables:
        inner = tree.setdefault(name, {})
        if not isinstance(inner, dict):
            raise ConfigError(f"{whose} {key}: {name} is a value, not a table")
        tree = inner
    tree[last] = value


def printable(text: str) -> str:
    r"""A text from elsewhere for a terminal or XML: control characters as `\x1b`, line ends and tabs stay."""
    return _CONTROL.sub(lambda match: match[0].encode("unicode_escape").decode("ascii"), text)
