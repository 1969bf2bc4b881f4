"""The keeper's process: started apart from everything, deaf to signals, ended only by an `off` that is done.

    python -m hil.drivers.adhesion.keeper SPEC [--stay] [--understudy] [--emulated] [--log FILE]

The first line on stdout says whether it works: its process id, or the error. Then it is silent. A keeper of
a running fan starts a second one as its understudy.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import EXIT_DEVICE, HilError, UsageError
from hil.drivers.adhesion.keeper.beat import Beat, open_bus
from hil.drivers.adhesion.keeper.client import KEEPER, Status
from hil.drivers.adhesion.keeper.core import Keeper, SetPoint
from hil.drivers.adhesion.keeper.door import HOW_TO_ASK, IDLE_S, Door, Peer, TakenError
from hil.drivers.adhesion.keeper.log import Log
from hil.drivers.adhesion.keeper.spec import Spec
from hil.drivers.adhesion.keeper.surviving import be_deaf, detach, harden
from hil.drivers.adhesion.keeper.understudy import Understudies, stand_beside
from hil.support.emulated_can_mark import Emulation

_IDLE_NS = nanoseconds(IDLE_S)
_REPEAT_NS = nanoseconds(60.0)
_NAME_FREE_S = 0.002
_LOOK_NS = nanoseconds(0.5)


class Process:
    """A keeper with its bus, its socket and its log.

    Args:
        spec: the fan.
        log: told what happens.
        stay: go on waiting while the fan is nobody's or its bus is not there yet, as a service does.
        emulation: of the bus, by another process: the keeper ends with it.
    """

    def __init__(self, spec: Spec, log: Log, *, stay: bool, emulation: Emulation) -> None:
        self._spec, self._log, self._stay = spec, log, stay
        self._keeper = Keeper(spec)
        command = [*KEEPER, spec.to_json(), "--understudy"]
        command += [] if log.path is None else ["--log", str(log.path)]
        command += ["--emulated"] if emulation.known else []
        self._understudies = Understudies(spec, command, log.say)
        self._setters: set[int] = set()
        self._door = Door(spec, self._left)
        try:
            self._beat = Beat(spec, self._keeper, log.say, None if stay else open_bus(spec))
        except (HilError, OSError):
            self._door.close()
            raise
        self._emulation = emulation
        self._next_look_ns = 0
        self._began = time.time()
        self._used_ns = time.monotonic_ns()
        self._asked, self._asked_ns = ("", ""), 0

    def go_on_from(self, latest: Status) -> None:
        """Send what a keeper has sent whose last status is known."""
        if latest.get("sent") is None or latest.get("target") is None:
            return
        now_ns = time.monotonic_ns()
        self._keeper.resume(now_ns, SetPoint(*latest["sent"]), SetPoint(*latest["target"]))
        if latest["state"] == "ending":
            self._keeper.end(now_ns)
        self._log.say(f"the keeper, process {latest['pid']}, is gone; its understudy goes on")

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
                if self._keeper.sent is not None:
                    self._understudies.see_to_one(now_ns)
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
        if now_ns >= self._next_look_ns:
            self._next_look_ns = now_ns + _LOOK_NS
            if self._emulation.is_over():
                self._log.say(f"{self._spec.bus} was emulated and is gone; so is the keeper")
                return True
        if self._stay or self._keeper.sent is not None or self._door.clients:
            self._used_ns = now_ns
        return now_ns - self._used_ns > _IDLE_NS

    def _left(self, pid: int) -> None:
        """A client has hung up."""
        self._setters.discard(pid)
        self._understudies.left(pid)

    def _answer(self, asked: Mapping[str, Any], who: Peer) -> Mapping[str, Any]:
        """Do what a program asks for; raises `HilError` to refuse it."""
        now_ns, do = time.monotonic_ns(), asked.get("do")
        if do == "set":
            point = _point(asked)
            self._keeper.wish(now_ns, point)
            self._setters.add(who.pid)
            self._tell_of_wish(now_ns, str(who), point)
            if self._beat.sent_ns is None:
                self._beat.beat(now_ns)
        elif do == "off":
            why = asked.get("confirmed_by")
            if not isinstance(why, str) or not why.strip():
                raise UsageError(
                    "the fan is not stopped without a confirmation that the robot does not hang by it",
                    expected='"confirmed_by" and why nothing hangs by it',
                    remedy="`hil adhesion off --tethered`, or off the wall by load cells and IMU",
                )
            self._log.say(f"off, asked for by {who}, confirmed: {why[:200]}")
            self._keeper.end(now_ns)
        elif do == "status":
            if asked.get("as") == "understudy":
                self._understudies.heard(asked.get("pid"))
        else:
            raise UsageError(f"the keeper cannot {do!r}", expected="status, set or off", remedy=HOW_TO_ASK)
        return self._status(now_ns)

    def _tell_of_wish(self, now_ns: int, who: str, point: SetPoint) -> None:
        """Log who sets what; a bench that trims its set-point all the time is told of once a minute."""
        asked = (who, point.quantity)
        if asked != self._asked or now_ns - self._asked_ns > _REPEAT_NS:
            self._asked, self._asked_ns = asked, now_ns
            self._log.say(f"set to {point.quantity} {point.value:g} by {who}")

    def _status(self, now_ns: int) -> dict[str, Any]:
        return {
            **self._beat.status(now_ns),
            "pid": os.getpid(),
            "understudy": self._understudies.pid if self._understudies.present(now_ns) else None,
            "set_by": sorted(self._setters),
            "since": self._began,
            "log": str(self._log.path or ""),
        }


def _point(asked: Mapping[str, Any]) -> SetPoint:
    """The set-point that a request is about; raises `UsageError`."""
    quantity, value = asked.get("quantity"), asked.get("value")
    if not isinstance(quantity, str) or isinstance(value, bool) or not isinstance(value, (int, float)):
        raise UsageError(
            f"a set-point for the keeper of {quantity!r} and {value!r}",
            expected="a quantity and a number",
            remedy=HOW_TO_ASK,
        )
    try:
        return SetPoint(quantity, float(value))
    except OverflowError:
        return SetPoint(quantity, math.inf)


def main(argv: list[str] | None = None) -> int:
    """Start a keeper; in the background unless it is to stay."""
    parser = argparse.ArgumentParser(prog="keeper", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("spec", help="the fan, as Spec.to_json writes it")
    parser.add_argument("--stay", action="store_true", help="in the foreground, also without a fan to keep")
    parser.add_argument("--understudy", action="store_true", help="wait beside the keeper there is")
    parser.add_argument("--emulated", action="store_true", help="end with whoever emulates the bus")
    parser.add_argument("--log", type=Path, help="log file; stderr when not given")
    given = parser.parse_args(argv)
    if not given.stay:
        detach()
    try:
        spec = Spec.from_json(given.spec)
        log = Log(given.log)
        be_deaf(log.say)
        refused = harden()
        process = _opened(spec, log, given)
    except (HilError, OSError) as error:
        _tell({"error": str(error)})
        return error.exit_code if isinstance(error, HilError) else EXIT_DEVICE
    if process is None:
        log.close()
        return 0
    log.say(f"keeper of {spec.name}, process {os.getpid()}" + f"; not permitted: {refused}" * bool(refused))
    _tell({"pid": os.getpid()})
    if given.log is not None:
        _away_with(2)
    process.run()
    process.close()
    log.close()
    return 0


def _opened(spec: Spec, log: Log, given: argparse.Namespace) -> Process | None:
    """A keeper that has its fan, in an understudy once the other is gone; None where nobody needs it."""
    latest: Status = {}
    emulation = Emulation(spec.bus, known=given.emulated)
    while True:
        if emulation.is_over():
            gone, who = f"{spec.bus} was emulated and is gone", "understudy" if given.understudy else "keeper"
            log.say(f"{gone}; so is the {who}, process {os.getpid()}")
            _tell({"error": gone})
            return None
        try:
            process = Process(spec, log, stay=given.stay, emulation=emulation)
        except TakenError:
            if not (given.stay or given.understudy):
                raise
        else:
            process.go_on_from(latest)
            return process
        found = stand_beside(spec)
        if not found:  # it is just going, and its name with it
            time.sleep(_NAME_FREE_S)
            continue
        latest = found
        if latest["state"] == "idle" and not given.stay:
            return None


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
