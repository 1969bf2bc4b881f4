"""Lets a process outlive others: new session, signals ignored, real-time priority, locked memory."""

import contextlib
import ctypes
import gc
import os
import resource
import signal
from collections.abc import Callable
from pathlib import Path

from hil.core.clock import sleep_punctually

_NICE, _FIFO_PRIORITY = -15, 20
_OOM_SCORES = (-1000, -500)
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_MEANT_TO_END = ("SIGHUP", "SIGINT", "SIGTERM", "SIGQUIT")
_OTHERS = (
    "SIGPIPE",
    "SIGALRM",
    "SIGUSR1",
    "SIGUSR2",
    "SIGTSTP",
    "SIGTTIN",
    "SIGTTOU",
    "SIGXCPU",
    "SIGXFSZ",
    "SIGVTALRM",
    "SIGPROF",
    "SIGPWR",
    "SIGIO",
)


def ignore_signals(say: Callable[[str], None]) -> None:
    """Ignore all signals; those that are meant to end a program are logged by `say`."""

    def note(number: int, _frame: object) -> None:
        say(f"{signal.Signals(number).name} is not heeded: `hil adhesion off` stops the fan")

    for name in _MEANT_TO_END:
        signal.signal(getattr(signal, name), note)
    for name in _OTHERS:
        signal.signal(getattr(signal, name), signal.SIG_IGN)


def detach() -> None:
    """Leave process group, session and parent, so that this process does not end with them."""
    if os.fork():
        os._exit(0)
    os.setsid()
    if os.fork():
        os._exit(0)
    os.chdir("/")


def harden() -> str:
    """Get real-time priority, lock memory, lower the OOM score; returns what was not permitted, in words."""
    refused = []
    sleep_punctually()
    try:
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(_FIFO_PRIORITY))
    except OSError:
        refused.append("real-time priority")
        with contextlib.suppress(OSError):
            os.nice(_NICE)
    for score in _OOM_SCORES:
        with contextlib.suppress(OSError):
            Path("/proc/self/oom_score_adj").write_text(str(score))
            break
    else:
        refused.append("protection when memory runs out")
    if not _locked_in_memory():
        refused.append("locked memory")
    gc.collect()
    gc.freeze()
    return ", ".join(refused)


def _locked_in_memory() -> bool:
    """Lock present memory, and future allocations only where no limit could make one fail."""
    unlimited = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    flags = _MCL_CURRENT | (_MCL_FUTURE if unlimited else 0)
    return bool(ctypes.CDLL(None, use_errno=True).mlockall(flags) == 0)
