"""Shows every bench that this process opens to the one function that has asked for it.

In this way the pytest plugin reports and records a bench that a test opens by itself, and refuses one that
would move hardware which the command line does not name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

_ASKED: list[Callable[[Any], object]] = []
_GUARDS: list[Callable[[Any, Any], object]] = []


@contextmanager
def shown_to(function: Callable[[Any], object]) -> Iterator[None]:
    """Have `function` called with every `hil.Bench`, before its devices are opened, while this lasts.

    Within another one only the inner one is called.
    """
    _ASKED.append(function)
    try:
        yield
    finally:
        _ASKED.remove(function)


def show(bench: Any) -> None:
    """Call the function that has asked last; does nothing where none has."""
    if _ASKED:
        _ASKED[-1](bench)


@contextmanager
def guarded_by(function: Callable[[Any, Any], object]) -> Iterator[None]:
    """Have `function` called before a bench is put together, while this lasts; it raises to refuse it.

    It is given what the bench was asked for by (file, name or configuration), and the configuration that
    comes of it. Within another one only the inner one is called.
    """
    _GUARDS.append(function)
    try:
        yield
    finally:
        _GUARDS.remove(function)


def ask(given: Any, config: Any) -> None:
    """Call the guard that was set last; does nothing where there is none."""
    if _GUARDS:
        _GUARDS[-1](given, config)
