"""Log messages of a campaign's runs on stderr, each with the name of its case."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

_CASE: ContextVar[str] = ContextVar("case", default="")
"""Of the thread: a worker may have several, each with a run of its own."""


class _Named(logging.LogRecord):
    def __init__(self, *arguments: Any, **more: Any) -> None:
        super().__init__(*arguments, **more)
        self._case = _CASE.get()

    def getMessage(self) -> str:
        """The text, behind the case that ran in the thread that logged it."""
        said = super().getMessage()
        return f"{self._case}: {said}" if self._case else said


@contextmanager
def named_in_log(case: str) -> Iterator[None]:
    """What is logged meanwhile in this thread names the case."""
    logging.setLogRecordFactory(_Named)
    before = _CASE.set(case)
    try:
        yield
    finally:
        _CASE.reset(before)
