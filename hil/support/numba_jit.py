"""Compiles numerical functions by numba: `njit`, its cache, and messages while it compiles.

`kernel` marks functions that Python calls, `inner` those that kernels call and that Python runs uncompiled.
numba caches the code of a kernel until the kernel's own file changes, although it contains the code of all
functions that it calls from other files. So every state of the sources has its own cache folder;
`NUMBA_CACHE_DIR`, if it is set, is used unchanged. `NUMBA_DISABLE_JIT=1` runs everything as plain Python.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import shutil
import signal
import tempfile
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar, cast

import numba
import numba.extending
from numba.core import caching, event

from hil.core.clock import MonotonicClock, nanoseconds
from hil.core.errors import HilError, reason_of

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T", bound=tuple[Any, ...])

_LOG = logging.getLogger(__name__)
PROGRESS = logging.getLogger(f"{__name__}.progress")
"""Logger of running compilations and their duration."""
_PACKAGE = Path(__file__).parents[1]
_SOURCES = ("calibration", "config", "controller", "estimator", "fakes", "loop", "robot", "core", "support")
"""Folders of kernels and of all that they import."""
_FIRST_WORD_NS, _NEXT_WORD_NS = nanoseconds(2.0), nanoseconds(10.0)

if (
    "NUMBA_OPT" not in os.environ
):  # LLVM's effort, 1 of 3: compiled in 3/4 of the time, a tenth slower at most
    numba.config.OPT = type(numba.config.OPT)(1)


def kernel(function: F) -> F:
    """Compile a function at its first call from Python, with the inner ones that it calls, and cache it."""
    made = numba.njit(no_cfunc_wrapper=True)(function)
    if made is not function:
        made._cache = _cache_of(function)  # as `cache=True` does with numba's own
    return cast(F, made)


def inner(function: F) -> F:
    """Mark a function that kernels call as machine code; Python runs it uncompiled."""
    return cast(F, numba.extending.register_jitable(no_cfunc_wrapper=True)(function))


def plain(values: T) -> T:
    """A named tuple as a plain tuple, whose type numba finds five times faster, microseconds per call."""
    return cast(T, tuple(values))


def compile_for(function: Callable[..., Any], *arguments: Any) -> None:
    """Load or compile a kernel for the types of these arguments, without running it."""
    if not numba.config.DISABLE_JIT:
        cast(Any, function).compile(tuple(map(numba.typeof, arguments)))


def cache_folder(package: Path, homes: tuple[Path, ...]) -> str:
    """Folder for the machine code of these sources, in the first writable home; deletes all others there.

    Args:
        package: folder of the package.
        homes: folders that hold nothing else, the best one first.

    Returns:
        Empty where none can be written.
    """
    digest = hashlib.sha256()
    for path in sorted(path for name in _SOURCES for path in (package / name).rglob("*.py")):
        digest.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes())
    for home in homes:
        folder = home / digest.hexdigest()[:16]
        try:
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
        except OSError:
            continue
        for other in home.iterdir():
            if other != folder:
                shutil.rmtree(other, ignore_errors=True)
        return str(folder)
    return ""


def _homes() -> tuple[Path, Path]:
    """Folders for machine code: beside the sources, else in the user's cache."""
    at = hashlib.sha256(str(_PACKAGE).encode()).hexdigest()[:16]
    of_user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return _PACKAGE / "__pycache__" / "kernels", of_user / "hil" / at


class _Cache(caching.FunctionCache):  # type: ignore[misc]
    """Cache whose read and write errors, as on a full disk, cost time but end nothing."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the code for these types, if it is there and complete."""
        try:
            return super().load_overload(sig, target_context)
        except HilError:  # raised by a signal handler
            raise
        except Exception:  # a truncated file may raise anything
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save the code for these types; warn if that fails."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            _watch.tell_not_kept(f"in {self.cache_path} ({reason_of(error)})")


class _NoCache(caching.NullCache):  # type: ignore[misc]
    """Cache for a function whose code no folder can hold."""

    def save_overload(self, sig: Any, data: Any) -> None:
        """Warn that the code is not kept."""
        _watch.tell_not_kept("beside the sources, nor in the user's cache")


def _cache_of(function: Callable[..., Any]) -> Any:
    try:
        return _Cache(function)
    except RuntimeError:  # one that was typed at a prompt has no file, either
        return _NoCache() if os.path.exists(function.__code__.co_filename) else caching.NullCache()


class _Watch(event.Listener):  # type: ignore[misc]
    """Listens to numba's compiler: reports a long compilation, and lets Ctrl-C end it at the next step.

    An exception that a signal handler raised inside LLVM, which calls Python, would be lost.
    """

    def __init__(self) -> None:
        self._clock, self._depth, self._begun_ns, self._reported_ns = MonotonicClock(), 0, 0, 0
        self._spent_ns, self._functions, self._not_kept = 0, 0, False
        self._handler: Any = None
        self._struck: Callable[[], object] | None = None
        self._raised: BaseException | None = None

    def on_start(self, event: Any) -> None:
        """Note that a compilation begins; at each step of it, act on Ctrl-C."""
        if event.kind == "numba:run_pass":
            try:
                self._heed()
            except BaseException as error:
                self._raised = error
                raise KeyboardInterrupt from None  # the only exception that numba passes on
            return
        self._depth += 1
        self._functions += 1
        if self._depth == 1:
            self._begun_ns = self._clock.now_ns()
            if threading.current_thread() is threading.main_thread():
                self._handler = signal.getsignal(signal.SIGINT)
                if callable(self._handler):
                    signal.signal(signal.SIGINT, self._strike)
        self._tell()

    def on_end(self, event: Any) -> None:
        """Count the time of a compilation that has ended."""
        if event.kind == "numba:run_pass":
            return
        self._depth -= 1
        if not self._depth:
            self._spent_ns += self._clock.now_ns() - self._begun_ns
            if callable(self._handler):
                signal.signal(signal.SIGINT, self._handler)
            self._handler = None
            raised, self._raised = self._raised, None
            if raised is not None:
                raise raised
            self._heed()

    def tell_not_kept(self, where: str) -> None:
        """Warn, once per process, that machine code is not kept."""
        if not self._not_kept:
            self._not_kept = True
            _LOG.warning(
                "machine code cannot be kept %s; it is compiled again next time: make room there, or set "
                "NUMBA_CACHE_DIR to a folder that can be written",
                where,
            )

    def _strike(self, number: int, frame: FrameType | None) -> None:
        self._struck = partial(self._handler, number, frame)

    def _heed(self) -> None:
        struck, self._struck = self._struck, None
        if struck is not None:
            struck()

    def _tell(self) -> None:
        spent_ns = self._spent_ns + self._clock.now_ns() - self._begun_ns
        if spent_ns > self._reported_ns + (_NEXT_WORD_NS if self._reported_ns else _FIRST_WORD_NS):
            self._reported_ns = spent_ns
            PROGRESS.warning(
                "compiling the numerical kernels, once for this version (`hil info --compile` does it "
                "beforehand): %d functions in %.0f s",
                self._functions,
                spent_ns * 1e-9,
            )


_watch = _Watch()
for _kind in ("numba:compile", "numba:run_pass"):
    event.register(_kind, _watch)
if not numba.config.CACHE_DIR:
    numba.config.CACHE_DIR = cache_folder(_PACKAGE, _homes())
