"""Compiles numerical functions by numba: `njit`, its cache, and messages while it compiles.

`kernel` marks functions that Python calls, `inner` those that kernels call and that Python runs uncompiled.
numba keeps the machine code of a kernel until the kernel's own file changes. The code also contains the
functions that it calls from other files, so here it is kept until one of the imported files of the package
changes. It lies beside the sources, or in the user's cache where that folder cannot be written; code that
another user has left beside the sources is read. `NUMBA_CACHE_DIR`, if it is set, replaces both places.
`NUMBA_DISABLE_JIT=1` runs everything as plain Python.
"""

import contextlib
import fcntl
import hashlib
import logging
import os
import re
import shutil
import signal
import sys
import threading
from collections.abc import Callable
from functools import cache, partial
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
_IMPORT = re.compile(r"^\s*(?:from\s+([\w.]+)\s+import\s+(\([^)]*\)|.*)|import\s+(.*))", re.MULTILINE)
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


def homes(package: Path = _PACKAGE) -> tuple[Path, ...]:
    """Folders for machine code of a package: beside its sources, then in the user's cache."""
    if numba.config.CACHE_DIR:
        return (Path(numba.config.CACHE_DIR),)
    at = hashlib.sha256(str(package).encode()).hexdigest()[:16]
    of_user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return package / "__pycache__" / "kernels", of_user / "hil" / at


@cache
def _digest_and_imports(source: Path, _changed_ns: int, _size: int) -> tuple[bytes, tuple[Path, ...]]:
    """Digest of a file, and the files of the package that its import statements name."""
    text, found = source.read_bytes(), set[Path]()
    for module, names, plain_names in _IMPORT.findall(text.decode()):
        listed = re.findall(r"[\w.]+", names or plain_names)
        for dotted in (module, *(f"{module}.{name}".strip(".") for name in listed)):
            top, *parts = dotted.split(".")
            if top == _PACKAGE.name:
                base = _PACKAGE.joinpath(*parts)
                found |= {f for f in (base.with_suffix(".py"), base / "__init__.py") if f.is_file()}
    return hashlib.sha256(text).digest(), tuple(found)


def stamp(source: Path) -> str:
    """Digest of a file and of all files of the package that it imports, directly or through others."""
    seen, left, digest = dict[Path, bytes](), [source], hashlib.sha256()
    while left:
        if (one := left.pop()) not in seen:
            state = one.stat()
            seen[one], imported = _digest_and_imports(one, state.st_mtime_ns, state.st_size)
            left += imported
    for one in sorted(seen):
        digest.update(one.name.encode() + b"\0" + seen[one])
    return digest.hexdigest()


class _Locator(caching._CacheLocator):  # type: ignore[misc]
    """Folder of the machine code of one function in one home, by source file and state of its imports."""

    def __init__(self, function: Callable[..., Any], home: Path, state: str) -> None:
        source = Path(function.__code__.co_filename)
        inside = source.is_relative_to(_PACKAGE)
        name = ".".join(source.relative_to(_PACKAGE).with_suffix("").parts) if inside else source.stem
        path = "" if inside else hashlib.sha256(str(source).encode()).hexdigest()[:16]
        self._py_file, self._line = str(source), function.__code__.co_firstlineno
        self._of_source, self._stamp = home / f"{name}{path}", state

    def ensure_cache_path(self) -> None:
        """Make the folder, and delete those of other states of the source."""
        super().ensure_cache_path()
        for other in self._of_source.iterdir():
            if other.name != self._stamp[:16]:
                shutil.rmtree(other, ignore_errors=True)

    def get_cache_path(self) -> str:
        """Folder, which need not exist."""
        return str(self._of_source / self._stamp[:16])

    def get_source_stamp(self) -> str:
        """Digest of the source and its imports."""
        return self._stamp

    def get_disambiguator(self) -> str:
        """Line of the function: two of a file may have one name."""
        return str(self._line)


class _Impl(caching.CompileResultCacheImpl):  # type: ignore[misc]
    """Names and contents of numba's cache files, in the folder of a locator."""

    def __init__(self, function: Callable[..., Any], locator: _Locator) -> None:
        self._locator, self._lineno = locator, function.__code__.co_firstlineno
        self._filename_base = self.get_filename_base(function.__qualname__, sys.abiflags)


class _Home(caching.Cache):  # type: ignore[misc]
    """Machine code of one function in one home."""

    def __init__(self, function: Callable[..., Any], home: Path, state: str) -> None:
        self._impl_class = partial(_Impl, locator=_Locator(function, home, state))
        super().__init__(function)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save the code for these types; what processes save at the same time is all kept."""
        self._impl.locator.ensure_cache_path()
        with open(Path(self.cache_path) / "lock", "w", encoding="ascii") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            super().save_overload(sig, data)


class _Cache(caching.NullCache):  # type: ignore[misc]
    """Machine code of one function in all homes; read and write errors cost time but end nothing."""

    def __init__(self, function: Callable[..., Any]) -> None:
        state = stamp(Path(function.__code__.co_filename))
        self._homes = [_Home(function, home, state) for home in homes()]

    @property
    def cache_path(self) -> str:
        """Folder of the best home."""
        return str(self._homes[0].cache_path)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the code for these types from the first home that has it complete."""
        for home in self._homes:
            try:
                if (code := home.load_overload(sig, target_context)) is not None:
                    return code
            except HilError:  # raised by a signal handler
                raise
            except Exception:  # a truncated file may raise anything
                with contextlib.suppress(OSError):
                    home.flush()
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save the code for these types in the first home that takes it; warn if none does."""
        refused = []
        for home in self._homes:
            try:
                home.save_overload(sig, data)
            except OSError as error:
                refused.append(f"in {home.cache_path} ({reason_of(error)})")
            else:
                return
        _watch.tell_not_kept(" or ".join(refused))


def _cache_of(function: Callable[..., Any]) -> Any:
    typed = not os.path.exists(function.__code__.co_filename)  # at a prompt, say
    return caching.NullCache() if typed else _Cache(function)


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
