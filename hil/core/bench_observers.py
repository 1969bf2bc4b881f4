"""Calls registered functions with every bench that this process opens.

The pytest plugin uses this to report and record a bench that a test opens by itself, and to refuse one that
would move hardware which the command line does not name.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

_ON_OPENED: list[Callable[[Any], object]] = []
_GUARDS: list[Callable[[Any, Any], object]] = []


@contextmanager
def on_bench_opened(function: Callable[[Any], object]) -> Iterator[None]:
    """Call `function` with every `hil.Bench` of the block, before its devices are opened.

    Of nested blocks only the innermost function is called.
    """
    _ON_OPENED.append(function)
    try:
        yield
    finally:
        _ON_OPENED.remove(function)


def show(bench: Any) -> None:
    """Call the innermost function of `on_bench_opened`, if there is one."""
    if _ON_OPENED:
        _ON_OPENED[-1](bench)


@contextmanager
def guarded_by(function: Callable[[Any, Any], object]) -> Iterator[None]:
    """Call `function` before a bench of the block is built; it raises to refuse the bench.

    Its arguments are the bench argument (file, name or configuration) and the resulting configuration. Of
    nested blocks only the innermost function is called.
    """
    _GUARDS.append(function)
    try:
        yield
    finally:
        _GUARDS.remove(function)


def call_guard(given: Any, config: Any) -> None:
    """Call the innermost function of `guarded_by`, if there is one."""
    if _GUARDS:
        _GUARDS[-1](given, config)
