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
from collections.abc import Callable, Iterator
from functools import cache
from types import CodeType, FunctionType, ModuleType
from typing import Any, TypeVar, cast

import numpy as np

from hil.vocabulary.compiling import interrupts_heeded, little_effort, numba

F = TypeVar("F", bound=Callable[..., Any])

AVAILABLE = numba is not None

_LIBRARIES = (math, np)
_PLAIN = (bool, int, float, complex, str, bytes, type(None), type(...))


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


def compiled_with_parts(function: F, *, long: bool = True) -> F:
    """Compile a plain function with the plain functions that it calls; these stay plain for everyone else.

    Args:
        function: what to compile.
        long: it takes milliseconds: other threads run while it does. Letting them in and waiting for them
            takes time, too, as much as a short kernel.

    Raises:
        ImportError: numba is not installed.
        TypeError: as for `compiled`.
    """
    from numba.extending import register_jitable

    for part in parts(function):
        register_jitable(part)
    made: F = _jitted(function, "_nogil", nogil=True) if long else _jitted(function, "_short")
    return made


def compile_for(kernel: Callable[..., Any], *arguments: Any) -> None:
    """Have a kernel compiled, or loaded, for the types of these arguments; it does not run.

    LLVM is asked for little effort, unless `NUMBA_OPT` says for how much. Results are the same bits.
    """
    if numba is not None:
        made: Any = getattr(kernel, "machine_code", kernel)
        with interrupts_heeded(), little_effort:
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
    types of every call takes four times as long, as long as half a step of the physics. Other threads wait
    while it runs.

    Raises:
        ImportError, TypeError: as for `compiled_with_parts`.
    """
    made: Any = compiled_with_parts(function, long=False)
    compile_for(made, *arguments)
    (found,) = made.overloads.values()
    return cast(F, found.entry_point)


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
