"""Keys of an operator, for as long as they are held.

A terminal reports no release of a key: it repeats a held one, usually 25 times a second or more, after a
first pause of up to 0.7 s. So a key counts as let go when it has not come for `LET_GO_S`. A held key moves
the robot for a moment, pauses, and goes on when its repeats begin. One that comes for longer than `LONGEST_S`
is ignored until it is let go: it may be stuck.
"""

import os
import select
import termios
import tty
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from hil.core.clock import nanoseconds

LET_GO_S, LONGEST_S = 0.15, 10.0
END, CLOSED, GONE = "x", "terminal closed", "gamepad lost"
LOST = (CLOSED, GONE)
"""Reasons of an end that the operator did not ask for."""
_ARROWS = {b"\x1b[A": b"w", b"\x1b[B": b"s", b"\x1b[D": b"a", b"\x1b[C": b"d"}
_CHUNK = 4096


@contextmanager
def key_by_key(descriptor: int) -> Iterator[None]:
    """Let a terminal pass on each key at once and print none; restores it at the end."""
    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)
    try:
        yield
    finally:
        with suppress(termios.error):  # the terminal may be gone
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


class Keys(ABC):
    """Source of the key that an operator holds.

    Args:
        now_ns: time of the bench.

    Attributes:
        ended: reason why there will be no more keys; empty before.
        ready: called when the keys are asked for the first time, with whether some came before, which count
            for nothing.
        stuck: number of times a key was held for too long.
    """

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self._now_ns = now_ns
        self._key, self._since_ns, self._ignored = "", 0, False
        self.ended, self.stuck = "", 0
        self.ready: Callable[[bool], object] | None = None
        self._early = False

    def over(self) -> str:
        """Why there will be no more keys; empty before. Until the keys count, key `x` is looked for here."""
        if self.ready is not None:
            self._early |= self.too_early()
        return self.ended

    def too_early(self) -> bool:
        """Whether a key is pressed now, before the keys count; it is not kept."""
        return bool(self.pressed(self._now_ns()))

    def held(self) -> str:
        """The held key, `w` for ahead and so on; empty for none. Never blocks."""
        if self.ready is not None:
            self.over()
            self.ready(self._early)
            self.ready = None
        now_ns = self._now_ns()
        key = self.pressed(now_ns)
        if key != self._key:
            self._key, self._since_ns, self._ignored = key, now_ns, False
        if key and not self._ignored and now_ns - self._since_ns > nanoseconds(LONGEST_S):
            self._ignored = True
            self.stuck += 1
        return "" if self._ignored or self.ended else key

    @abstractmethod
    def pressed(self, now_ns: int) -> str:
        """The key that is pressed at this time, however long; empty for none."""


class HeldKeys(Keys):
    """The key that is held at a terminal, or by a program that writes it again and again.

    Args:
        descriptor: terminal, in the mode of `key_by_key`; or a pipe.
        now_ns: time of the bench.
    """

    def __init__(self, descriptor: int, now_ns: Callable[[], int]) -> None:
        super().__init__(now_ns)
        self._descriptor, self._latest, self._last_ns = descriptor, "", 0
        self._asked_ns: int | None = None

    def pressed(self, now_ns: int) -> str:
        """The key that came last, until `LET_GO_S` after it.

        Keys that came before the first call, or while nobody asked for longer than `LET_GO_S`, are dropped.
        """
        before_ns, self._asked_ns = self._asked_ns, now_ns
        keys = self._arrived()
        if before_ns is None or now_ns - before_ns > nanoseconds(LET_GO_S):
            keys = ""
        if now_ns - self._last_ns > nanoseconds(LET_GO_S):
            self._latest = ""
        if keys:
            self._latest, self._last_ns = keys[-1], now_ns
        return self._latest

    def too_early(self) -> bool:
        """Whether keys have come since the last call; they are not kept."""
        return bool(self._arrived())

    def _arrived(self) -> str:
        """All keys since the last call."""
        data = b""
        while not self.ended and select.select([self._descriptor], [], [], 0.0)[0]:
            try:
                part = os.read(self._descriptor, _CHUNK)
            except OSError:
                part = b""
            if not part:
                self.ended = CLOSED
            data += part
        for arrow, key in _ARROWS.items():
            data = data.replace(arrow, key)
        keys = data.decode("ascii", "replace").lower()
        if END in keys:
            self.ended = f"key {END}"
        return keys
