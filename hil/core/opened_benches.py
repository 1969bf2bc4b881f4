"""Shows every bench that this process opens to the one function that has asked for it.

In this way the pytest plugin reports and records a bench that a test opens by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

_ASKED: list[Callable[[Any], object]] = []


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
