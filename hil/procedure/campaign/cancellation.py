"""Ends work on Dask early, by Ctrl-C or SIGTERM, without messages of Dask.

A call of Dask that a signal breaks into leaves callbacks behind that fail, and a client that leaves while
its jobs still run is reported missing with each result: both end as tracebacks in the log.
"""

from __future__ import annotations

import logging
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from types import FrameType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from distributed import Client, Future

_STRIKES = (signal.SIGINT, signal.SIGTERM)
_LOOKS, _LOOK_S = 200, 0.05


class Strikes:
    """Signals that are put off until Dask is not at work; a second one is not, for Dask may wait in vain.

    What handled them before is called, and raises what ends the work.
    """

    def __init__(self) -> None:
        self._former: dict[int, Any] = {}
        self._put_off: list[int] = []
        self._heard = False

    def __enter__(self) -> Strikes:
        self._former = _handlers()
        for number in self._former:
            signal.signal(number, self._strike)
        return self

    def __exit__(self, *_: object) -> None:
        _put_back(self._former)

    def _strike(self, number: int, frame: FrameType | None) -> None:
        if self._heard or self._put_off:
            self._former[number](number, frame)
        else:
            self._put_off.append(number)

    @contextmanager
    def heard(self) -> Iterator[None]:
        """Within, a signal strikes at once, also one that came before."""
        self._heard = True
        try:
            if self._put_off:
                number = self._put_off.pop()
                self._former[number](number, None)
            yield
        finally:
            self._heard = False


def take_back(client: Client, futures: Sequence[Future]) -> None:
    """Cancel jobs, and wait until the scheduler has done so and lists none of them any more."""
    reached = client.status == "running"
    client.cancel(futures, force=True)
    with suppress(OSError):  # a scheduler that goes meanwhile answers nothing either
        for _ in range(_LOOKS if reached else 0):
            if any(event.get("action") == "cancel" for _, event in client.get_events(client.id)):
                return
            threading.Event().wait(_LOOK_S)
    logging.getLogger("distributed").setLevel(logging.CRITICAL + 1)  # else each lost result is logged


def close_once(stack: ExitStack) -> None:
    """End client and workers; a second signal meanwhile only made Dask wait for them in vain, 10 s long."""
    handlers = _handlers()
    for number in handlers:
        signal.signal(number, signal.SIG_IGN)
    try:
        stack.close()
    finally:
        _put_back(handlers)


def _handlers() -> dict[int, Any]:
    """What signals are handled by here; those that are ignored, or end the process, are left alone."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    found = {number: signal.getsignal(number) for number in _STRIKES}
    return {number: handler for number, handler in found.items() if callable(handler)}


def _put_back(handlers: dict[int, Any]) -> None:
    for number, handler in handlers.items():
        signal.signal(number, handler)
