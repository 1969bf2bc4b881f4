"""The keeper's process: started apart from everything, deaf to signals, ended only by an `off` that is done.

    python -m hil.drivers.adhesion.keeper SPEC [--stay] [--emulator PID] [--log FILE]

The first line on stdout says whether it works: its process id, or the error. Then it is silent.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import gc
import json
import os
import resource
import select
import signal
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hil.drivers.adhesion.keeper.beat import Beat, open_bus
from hil.drivers.adhesion.keeper.core import Keeper, SetPoint
from hil.drivers.adhesion.keeper.door import Door
from hil.drivers.adhesion.keeper.log import Log
from hil.drivers.adhesion.keeper.spec import Spec
from hil.vocabulary.clock import NS_PER_S, nanoseconds, sleep_punctually
from hil.vocabulary.errors import EXIT_DEVICE, HilError, UsageError

_IDLE_NS = nanoseconds(30.0)
_REPEAT_NS = nanoseconds(60.0)
_NICE, _FIFO_PRIORITY = -15, 20
_OOM_SCORES = (-1000, -500)
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_MEANT_TO_END = ("SIGHUP", "SIGINT", "SIGTERM", "SIGQUIT")
_OTHERS = ("SIGPIPE", "SIGALRM", "SIGUSR1", "SIGUSR2", "SIGTSTP", "SIGTTIN", "SIGTTOU", "SIGXCPU", "SIGXFSZ",
           "SIGVTALRM", "SIGPROF", "SIGPWR", "SIGIO")  # fmt: skip


class Process:
    """A keeper with its bus, its socket and its log.

    Args:
        spec: the fan.
        log: told what happens.
        stay: go on waiting while the fan is nobody's or its bus is not there yet, as a service does.
        emulator: process without which there is no fan; None for a real one.
    """

    def __init__(self, spec: Spec, log: Log, *, stay: bool, emulator: int | None) -> None:
        self._spec, self._log, self._stay = spec, log, stay
        self._keeper = Keeper(spec)
        self._door = Door(spec)
        try:
            self._emulator = None if emulator is None else os.pidfd_open(emulator)
            self._beat = Beat(spec, self._keeper, log.say, None if stay else open_bus(spec))
        except (HilError, OSError):
            self._door.close()
            raise
        self._began = time.time()
        self._used_ns = time.monotonic_ns()
        self._asked, self._asked_ns = ("", ""), 0

    def run(self) -> None:
        """Keep the fan. Returns when it is nobody's, and nobody has asked for anything for a while."""
        period_ns = nanoseconds(self._spec.period_s)
        next_ns = time.monotonic_ns()
        while True:
            with self._whatever_happens():
                self._serve_until(next_ns)
            now_ns = time.monotonic_ns()
            next_ns = max(next_ns, now_ns - period_ns // 2) + period_ns
            with self._whatever_happens():
                self._beat.beat(now_ns)
            if self._unneeded(now_ns):
                return

    def close(self) -> None:
        """Let go of socket and bus."""
        self._door.close()
        self._beat.close()

    @contextlib.contextmanager
    def _whatever_happens(self) -> Iterator[None]:
        """A mistake in here must not stop the fan."""
        try:
            yield
        except Exception as error:
            self._log.say(f"went wrong, goes on: {type(error).__name__}: {error}")

    def _serve_until(self, end_ns: int) -> None:
        while (left_ns := end_ns - time.monotonic_ns()) > 0:
            self._door.serve(left_ns / NS_PER_S, self._answer)

    def _unneeded(self, now_ns: int) -> bool:
        if self._emulator is not None and _has_ended(self._emulator):
            self._log.say("the emulated fan is gone; so is its keeper")
            return True
        if self._stay or self._keeper.sent is not None or self._door.clients:
            self._used_ns = now_ns
        return now_ns - self._used_ns > _IDLE_NS

    def _answer(self, asked: Mapping[str, Any], who: str) -> Mapping[str, Any]:
        """Do what a program asks for; raises `HilError` to refuse it."""
        now_ns, do = time.monotonic_ns(), asked.get("do")
        if do == "set":
            quantity, value = asked.get("quantity"), asked.get("value")
            if (
                not isinstance(quantity, str)
                or isinstance(value, bool)
                or not isinstance(value, (int, float))
            ):
                raise UsageError("a set-point for the keeper", expected="a quantity and a number")
            self._keeper.wish(now_ns, SetPoint(quantity, float(value)))
            self._tell_of_wish(now_ns, who, quantity, value)
            if self._beat.sent_ns is None:
                self._beat.beat(now_ns)
        elif do == "off":
            why = asked.get("confirmed_by")
            if not isinstance(why, str) or not why.strip():
                raise UsageError(
                    "the fan is not stopped without a confirmation that the robot does not hang by it",
                    remedy="`hil adhesion off --tethered`, or off the wall by load cells and IMU",
                )
            self._log.say(f"off, asked for by {who}, confirmed: {why[:200]}")
            self._keeper.end(now_ns)
        elif do != "status":
            raise UsageError(f"the keeper cannot {do!r}", expected="status, set or off")
        return self._status(now_ns)

    def _tell_of_wish(self, now_ns: int, who: str, quantity: str, value: float) -> None:
        """Log who sets what; a bench that trims its set-point all the time is told of once a minute."""
        asked = (who, quantity)
        if asked != self._asked or now_ns - self._asked_ns > _REPEAT_NS:
            self._asked, self._asked_ns = asked, now_ns
            self._log.say(f"set to {quantity} {value:g} by {who}")

    def _status(self, now_ns: int) -> dict[str, Any]:
        return {
            **self._beat.status(now_ns),
            "pid": os.getpid(),
            "since": self._began,
            "log": str(self._log.path or ""),
        }

    def heed(self, number: int, _frame: object) -> None:
        """Note a signal that is meant to end a program, and go on."""
        self._log.say(f"{signal.Signals(number).name} is not heeded: `hil adhesion off` stops the fan")


def _has_ended(pidfd: int) -> bool:
    return bool(select.select([pidfd], [], [], 0)[0])


def detach() -> None:
    """Leave the process group, session and parent: what ends those ends nothing here."""
    if os.fork():
        os._exit(0)
    os.setsid()
    if os.fork():
        os._exit(0)
    os.chdir("/")


def harden() -> str:
    """Go first, stay in memory, be the last to be killed for want of it; what was not permitted, in words."""
    refused = []
    sleep_punctually()
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_FIFO_PRIORITY))
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
    """Lock what there is; later allocations only where no limit could make one fail."""
    unlimited = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    flags = _MCL_CURRENT | (_MCL_FUTURE if unlimited else 0)
    return bool(ctypes.CDLL(None, use_errno=True).mlockall(flags) == 0)


def main(argv: list[str] | None = None) -> int:
    """Start a keeper; in the background unless it is to stay."""
    parser = argparse.ArgumentParser(prog="keeper", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("spec", help="the fan, as Spec.to_json writes it")
    parser.add_argument("--stay", action="store_true", help="in the foreground, also without a fan to keep")
    parser.add_argument("--emulator", type=int, help="end together with this process")
    parser.add_argument("--log", type=Path, help="log file; stderr when not given")
    given = parser.parse_args(argv)
    if not given.stay:
        detach()
    try:
        spec = Spec.from_json(given.spec)
        log = Log(given.log)
        process = Process(spec, log, stay=given.stay, emulator=given.emulator)
    except (HilError, OSError) as error:
        _tell({"error": str(error)})
        return error.exit_code if isinstance(error, HilError) else EXIT_DEVICE
    for name in _MEANT_TO_END:
        signal.signal(getattr(signal, name), process.heed)
    for name in _OTHERS:
        signal.signal(getattr(signal, name), signal.SIG_IGN)
    refused = harden()
    log.say(f"keeper of {spec.name}, process {os.getpid()}" + f"; not permitted: {refused}" * bool(refused))
    _tell({"pid": os.getpid()})
    if given.log is not None:
        _away_with(2)
    process.run()
    process.close()
    log.close()
    return 0


def _tell(said: Mapping[str, object]) -> None:
    """The one line for whoever started this; standard streams lead nowhere afterwards."""
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.write(json.dumps(said) + "\n")
        sys.stdout.flush()
    _away_with(0, 1)


def _away_with(*descriptors: int) -> None:
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in descriptors:
        os.dup2(nowhere, descriptor)
    os.close(nowhere)
