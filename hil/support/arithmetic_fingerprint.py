"""Identifies the arithmetic of this computer, which decides the last bits of a computed number.

The four operations and the square root give the same bits on every processor. Sines, matrix products,
inverses and sums do not: numpy, OpenBLAS and the C library each choose code by what the processor can do.
The fingerprint names these choices. Two computers with equal fingerprints compute equal bits; with other
ones the last digits differ.
"""

import os
import platform
import sys
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
from threadpoolctl import ThreadpoolController

from hil.support.versions import version_of

_LIBM_CHOOSES_BY = ("avx2", "fma", "fma4")
"""Features of x86 processors for which glibc has versions of its mathematical functions."""
_NUMBA_FILE = ".numba_config.yaml"
_HWCAPS = "glibc.cpu.hwcaps="


@cache
def fingerprint() -> dict[str, str]:
    """Names and versions of everything that computes, as texts by these keys.

    `machine` (of the processor), `python` (its sums of floats changed with 3.12), `numpy`, `scipy`, `simd`
    (instruction sets that numpy uses), `blas` (library, version and kernel), `libm` (version, and the
    processor's features that it chooses by), `numba` (its version, LLVM's, and the processor that it
    compiles for).
    """
    return {
        "machine": platform.machine(),
        "python": ".".join(platform.python_version_tuple()[:2]),
        "numpy": np.__version__,
        "scipy": version_of("scipy"),
        "simd": _simd(),
        "blas": _blas(),
        "libm": _libm(),
        "numba": _numba(),
    }


def differences(recorded: dict[str, str], here: dict[str, str]) -> dict[str, tuple[str, str]]:
    """Keys in which two fingerprints differ, each with both values; `unknown` for one that is missing."""
    keys = [*here, *(key for key in recorded if key not in here)]
    pairs = {key: (recorded.get(key, "unknown"), here.get(key, "unknown")) for key in keys}
    return {key: pair for key, pair in pairs.items() if pair[0] != pair[1]}


def _simd() -> str:
    """Instruction sets that numpy uses: those that it was built for, and further ones found at run time."""
    core = "numpy._core" if int(np.__version__.partition(".")[0]) >= 2 else "numpy.core"
    found = import_module(f"{core}._multiarray_umath")
    dispatched = [name for name in found.__cpu_dispatch__ if found.__cpu_features__.get(name)]
    return " ".join([*found.__cpu_baseline__, *dispatched])


def _blas() -> str:
    """The library behind numpy's matrix products, and the kernel that it has chosen."""
    libraries = [lib for lib in ThreadpoolController().info() if lib["user_api"] == "blas"]
    ours = [lib for lib in libraries if "numpy" in lib["filepath"]] or libraries
    if not ours:
        return "unknown"
    library = ours[0]
    return " ".join(
        str(library[key]) for key in ("internal_api", "version", "architecture") if library.get(key)
    )


def _libm() -> str:
    name, version = platform.libc_ver()
    flags: set[str] = set()
    if platform.machine() in ("x86_64", "i686"):
        flags = set(_LIBM_CHOOSES_BY) & _processor_flags() - _masked()
    return " ".join([name or "unknown", version, *sorted(flags)]).strip()


def _processor_flags() -> set[str]:
    """Features of the processor as reported by the kernel."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return set()
    return next((set(line.split()) for line in lines if line.startswith("flags")), set())


def _masked() -> set[str]:
    """Features that the C library is set to do without, in lower case."""
    tunables = os.environ.get("GLIBC_TUNABLES", "").split(":")
    masks = ",".join(one.removeprefix(_HWCAPS) for one in tunables if one.startswith(_HWCAPS))
    return {name[1:].lower().removesuffix("_usable") for name in masks.split(",") if name.startswith("-")}


def _numba_setting(name: str) -> object:
    """A setting of numba; importing numba to learn that nothing sets it would take a second."""
    if "numba" not in sys.modules and not (f"NUMBA_{name}" in os.environ or Path(_NUMBA_FILE).exists()):
        return None
    from numba.core import config

    return getattr(config, name)


def _numba() -> str:
    from llvmlite import binding

    llvm = ".".join(map(str, binding.llvm_version_info))
    target = _numba_setting("CPU_NAME") or binding.get_host_cpu_name()
    interpreted = " interpreted" if _numba_setting("DISABLE_JIT") else ""
    return f"{version_of('numba')} LLVM {llvm} {target}{interpreted}"
