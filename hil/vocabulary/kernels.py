"""Kernels: numerical functions that numba compiles where it is installed and Python runs where it is not.

Both give the same results (tests compare them). Nothing is compiled before the first call; the machine code
is kept beside the sources or in the user's cache. numba keeps the code of a function until that function's
own file changes, although it contains the code of everything that it calls. Here a kernel's name in the cache
therefore carries a fingerprint: of its own code, of every kernel that it calls, and of every constant that it
reads. What has no fingerprint is refused when the kernel is defined, so that no old code can run unnoticed.
"""

from __future__ import annotations

import builtins
import dis
import hashlib
import math
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from types import CodeType, FrameType, FunctionType, ModuleType
from typing import Any, TypeVar, cast

import numpy as np

from hil.vocabulary.when_asked import import_when_asked

F = TypeVar("F", bound=Callable[..., Any])

# numba loads scipy, which asks numpy for all of its names: half of that time was for Fortran's wrappers
import_when_asked(np, "f2py")

try:
    import numba
except ImportError:
    numba = None

AVAILABLE = numba is not None

_LIBRARIES = (math, np)
_PLAIN = (bool, int, float, complex, str, bytes, type(None), type(...))
_LLVM_EFFORT = 1
"""Of 3: kernels are compiled in three quarters of the time, and are a tenth slower at the most."""


def compiled(function: F) -> F:
    """Mark a kernel: compiled for the types of its first arguments, kept where a cache can be written.

    Kernels that it calls stand above it or are imported by name.

    Raises:
        TypeError: it uses something that has no fingerprint: see `fingerprint`.
    """
    return function if numba is None else _jitted(function, "")


def inner(function: F) -> F:
    """Mark a kernel that only kernels call; see `compiled`. Python that calls it runs it uncompiled.

    Machine code is made without the way in from Python, which takes a quarter of the time; `entry` makes it.
    """
    if numba is not None:
        made: Any = function
        made.machine_code = _jitted(function, "_inner", no_cpython_wrapper=True)
        made._numba_type_ = made.machine_code._numba_type_  # what numba takes the function for
    return function


def entry(kernel: F) -> F:
    """An inner kernel as Python calls it compiled."""

    def call(*arguments: Any) -> Any:
        return kernel(*arguments)

    call.__qualname__ = kernel.__qualname__
    if numba is None:
        return kernel
    made: F = _jitted(call, "_entry")
    return made


def _jitted(function: F, kept_as: str, **options: bool) -> Any:
    """The function as numba makes it; the name of its code in the cache ends with `kept_as`."""
    from hil.vocabulary.kept_code import store_of

    name = function.__qualname__
    options["no_cfunc_wrapper"] = True  # nobody calls a kernel from C
    try:
        function.__qualname__ = f"{name}_{fingerprint(function)}{kept_as}"
        made = numba.njit(**options)(function)
        made._cache = store_of(function)  # as `cache=True` does with numba's own
        return made
    finally:
        function.__qualname__ = name


def compiled_with_parts(function: F) -> F:
    """Compile a plain function with the plain functions that it calls; these stay plain for everyone else.

    Other threads run while it does: for kernels that take milliseconds.

    Raises:
        ImportError: numba is not installed.
        TypeError: as for `compiled`.
    """
    from numba.extending import register_jitable

    for part in parts(function):
        register_jitable(part)
    made: F = _jitted(function, "_nogil", nogil=True)
    return made


def compile_for(kernel: Callable[..., Any], *arguments: Any) -> None:
    """Have a kernel compiled, or loaded, for the types of these arguments; it does not run.

    LLVM is asked for little effort, unless `NUMBA_OPT` says for how much. Results are the same bits.
    """
    if numba is not None:
        made: Any = getattr(kernel, "machine_code", kernel)
        with interrupts_heeded(), _little_effort:
            made.compile(tuple(map(numba.typeof, arguments)))


def not_kept() -> str:
    """What was told about code that this process could not keep; empty where all could be kept."""
    if numba is None:
        return ""
    from hil.vocabulary.kept_code import told

    return told()


def machine_code(function: F, *arguments: Any) -> F:
    """A plain function as machine code for the types of these arguments, with the functions that it calls.

    It must be called with these types and no others: what is given does not look. numba's own choice by the
    types of every call takes four times as long, as long as half a step of the physics.

    Raises:
        ImportError, TypeError: as for `compiled_with_parts`.
    """
    made: Any = compiled_with_parts(function)
    compile_for(made, *arguments)
    (found,) = made.overloads.values()
    return cast(F, found.entry_point)


class _LittleEffort:
    """Within, by however many threads, LLVM optimises less; what others compile is left alone."""

    def __init__(self) -> None:
        self._lock, self._within = threading.Lock(), 0
        self._before: Any = None

    def __enter__(self) -> None:
        with self._lock:
            if not self._within:
                self._before = numba.config.OPT
                if "NUMBA_OPT" not in os.environ:
                    numba.config.OPT = type(self._before)(_LLVM_EFFORT)
            self._within += 1

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._within -= 1
            if not self._within:
                numba.config.OPT = self._before


_little_effort = _LittleEffort()


@contextmanager
def interrupts_heeded() -> Iterator[None]:
    """Within, Ctrl-C ends a compilation wherever it strikes: LLVM calls Python, and loses what is raised.

    What was lost is raised when numba begins its next step, at the end of the block at the latest.
    """
    handler, shown = signal.getsignal(signal.SIGINT), sys.unraisablehook
    if not _in_main_thread() or not callable(handler):
        yield
        return
    struck = False

    def strike(number: int, frame: FrameType | None) -> None:
        nonlocal struck
        struck = True
        handler(number, frame)

    def show(lost: sys.UnraisableHookArgs) -> None:
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            shown(lost)

    def heed() -> None:
        if struck and handler is signal.default_int_handler and _in_main_thread():
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, strike)
    sys.unraisablehook = show
    try:
        with _told_of("run_pass", heed):
            yield
    except Exception:
        if struck:
            raise KeyboardInterrupt from None
        raise
    finally:
        signal.signal(signal.SIGINT, handler)
        sys.unraisablehook = shown
    heed()


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


@contextmanager
def on_compiling(call: Callable[[], None]) -> Iterator[None]:
    """Within, a function is called whenever numba begins to compile something that it has not kept."""
    with _told_of("compile", call):
        yield


@contextmanager
def _told_of(step: str, call: Callable[[], None]) -> Iterator[None]:
    """Within, a function is called whenever numba begins such a step: see `numba.core.event`."""
    if numba is None:
        yield
        return
    from numba.core import event

    class Told(event.Listener):  # type: ignore[misc]
        def on_start(self, _: Any) -> None:
            call()

        def on_end(self, _: Any) -> None:
            return None

    with event.install_listener(f"numba:{step}", Told()):
        yield


def plain(function: F) -> F:
    """The uncompiled form of a kernel, for comparing both."""
    return cast(F, getattr(function, "py_func", function))


@cache
def fingerprint(function: Callable[..., Any]) -> str:
    """Short hash of all that a function is compiled from: its code and what it uses, all the way down.

    Raises:
        TypeError: it uses what is neither a function, a number, a text, an array, nor a tuple of these, nor
            of Python, `math` or numpy; or a name that is not defined yet.
    """
    digest = hashlib.sha256(_code(plain(function).__code__, function.__doc__))
    for name, value in _uses(plain(function)):
        digest.update(name.encode() + b"=" + _said(value, f"{function.__qualname__} uses {name}"))
    return digest.hexdigest()[:12]


def parts(function: Callable[..., Any]) -> set[FunctionType]:
    """Plain forms of all functions that a function calls, directly or through others."""
    found: set[FunctionType] = set()
    left = [plain(function)]
    while left:
        for _, value in _uses(left.pop()):
            used = plain(value) if callable(value) else None
            if isinstance(used, FunctionType) and used not in found:
                found.add(used)
                left.append(used)
    return found


def _uses(function: Callable[..., Any]) -> Iterator[tuple[str, Any]]:
    """Names outside itself that a function reads, with their values; Python and libraries left out."""
    assert isinstance(function, FunctionType)
    free = dict(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True))
    for name in sorted(_globals(function.__code__) | set(free)):
        if name in free:
            yield name, free[name].cell_contents
        elif name in function.__globals__:
            value = function.__globals__[name]
            if not isinstance(value, ModuleType) or value not in _LIBRARIES:
                yield name, value
        elif not hasattr(builtins, name):
            raise TypeError(f"{function.__qualname__} uses {name}: a kernel stands below what it uses")


@cache
def _globals(code: CodeType) -> frozenset[str]:
    """Global names that a piece of code reads, that of functions inside it included."""
    inner = [c for c in code.co_consts if isinstance(c, CodeType)]
    read = (i for i in dis.get_instructions(code) if i.opname in ("LOAD_GLOBAL", "LOAD_NAME"))
    names = frozenset(str(i.argval) for i in read)
    return names.union(*map(_globals, inner))


def _code(code: CodeType, doc: str | None = None) -> bytes:
    """What the interpreter and numba go by: instructions, names and constants but the description."""
    names = repr((code.co_names, code.co_varnames, code.co_freevars))
    return (
        code.co_code
        + names.encode()
        + _said(tuple(c for c in code.co_consts if doc is None or c != doc), code.co_name)
    )


def _said(value: Any, where: str) -> bytes:
    """Bytes that change whenever a value does."""
    if isinstance(value, CodeType):
        return _code(value)
    if isinstance(value, (tuple, frozenset)):
        said = [_said(v, where) for v in value]
        return b"(" + b",".join(said if isinstance(value, tuple) else sorted(said)) + b")"
    if isinstance(value, (np.ndarray, np.generic)):
        return f"{value.dtype}{value.shape}".encode() + value.tobytes()
    if isinstance(value, _PLAIN):
        return f"{type(value).__name__} {value!r}".encode()
    if isinstance(value, type) and issubclass(value, tuple):
        return repr((value.__name__, getattr(value, "_fields", ()))).encode()
    if callable(value) and isinstance(plain(value), FunctionType):
        return fingerprint(plain(value)).encode()
    raise TypeError(
        f"{where}, a {type(value).__name__}: a kernel may use kernels, numbers, texts, tuples (also named) "
        "and arrays, imported by name, and math and numpy"
    )
