"""The daemon's process: detached from its parent, ignoring signals, ended only by an `off` that is done.

    python -m hil.fan_daemon SPEC [--stay] [--standby] [--emulated] [--log FILE]

The first line on stdout is a JSON object with its process id, or the error. Then it is silent. A daemon of
a running fan starts a second one as its standby.
"""

import argparse
import contextlib
import json
import math
import os
import queue
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import EXIT_DEVICE, HilError, UsageError
from hil.fan_daemon.bus_cycle import BusCycle, open_bus
from hil.fan_daemon.client import DAEMON, Status
from hil.fan_daemon.fan_control import FanControl, SetPoint
from hil.fan_daemon.process_hardening import detach, harden, ignore_signals
from hil.fan_daemon.server import HOW_TO_ASK, IDLE_S, Peer, Server, TakenError
from hil.fan_daemon.spec import Spec
from hil.fan_daemon.standby import StandbyStarter, wait_as_standby
from hil.support.emulated_can_mark import Emulation

_MOST_BYTES = 1 << 20
_MOST_WAITING = 1000


class Log:
    """Lines with their time of day; what cannot be written is lost.

    Args:
        path: the file, appended to and begun anew when it is long, readable by its owner; stderr when None.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self._lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._write, name="log", daemon=True)
        self._thread.start()

    def say(self, text: str) -> None:
        """Take a line. Never blocks nor raises, not in a signal handler either."""
        if self._lines.qsize() < _MOST_WAITING:
            self._lines.put(f"{time.strftime('%Y-%m-%d %H:%M:%S%z')} {text}\n")

    def close(self) -> None:
        """Write what waits, for a second at most."""
        self._lines.put(None)
        self._thread.join(1.0)

    def _write(self) -> None:
        while (line := self._lines.get()) is not None:
            with contextlib.suppress(OSError, ValueError):
                if self.path is None:
                    sys.stderr.write(line)
                    sys.stderr.flush()
                else:
                    _append(self.path, line)


def _append(path: Path, line: str) -> None:
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    if path.exists() and path.stat().st_size > _MOST_BYTES:
        path.replace(path.with_suffix(".log.1"))
    descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    with os.fdopen(descriptor, "a", encoding="utf-8") as file:
        file.write(line)


_IDLE_NS = nanoseconds(IDLE_S)
_REPEAT_NS = nanoseconds(60.0)
_NAME_FREE_S = 0.002
_LOOK_NS = nanoseconds(0.5)


class Process:
    """A daemon with its bus, its socket and its log.

    Args:
        spec: the fan.
        log: function that takes a line for each event.
        stay: True to go on waiting while the fan is not commanded or its bus is not there yet, as a service
            does.
        emulation: emulation of the bus by another process: the daemon ends with it.
    """

    def __init__(self, spec: Spec, log: Log, *, stay: bool, emulation: Emulation) -> None:
        self._spec, self._log, self._stay = spec, log, stay
        self._control = FanControl(spec)
        command = [*DAEMON, spec.to_json(), "--standby"]
        command += [] if log.path is None else ["--log", str(log.path)]
        command += ["--emulated"] if emulation.known else []
        self._standbys = StandbyStarter(spec, command, log.say)
        self._setters: set[int] = set()
        self._server = Server(spec, self._left)
        try:
            self._cycle = BusCycle(spec, self._control, log.say, None if stay else open_bus(spec))
        except (HilError, OSError):
            self._server.close()
            raise
        self._emulation = emulation
        self._next_look_ns = 0
        self._began = time.time()
        self._used_ns = time.monotonic_ns()
        self._asked, self._asked_ns = ("", ""), 0

    def go_on_from(self, latest: Status) -> None:
        """Go on with the set-point of a daemon that is gone, by its last status."""
        if latest.get("sent") is None or latest.get("target") is None:
            return
        now_ns = time.monotonic_ns()
        self._control.resume(now_ns, SetPoint(*latest["sent"]), SetPoint(*latest["target"]))
        if latest["state"] == "ending":
            self._control.end(now_ns)
        self._log.say(f"the daemon, process {latest['pid']}, is gone; its standby goes on")

    def run(self) -> None:
        """Command the fan. Returns when it is at rest, and no client has sent a request for a while."""
        period_ns = nanoseconds(self._spec.period_s)
        next_ns = time.monotonic_ns()
        while True:
            with self._whatever_happens():
                self._serve_until(next_ns)
            now_ns = time.monotonic_ns()
            next_ns = max(next_ns, now_ns - period_ns // 2) + period_ns
            with self._whatever_happens():
                self._cycle.step(now_ns)
                if self._control.sent is not None:
                    self._standbys.start_if_missing(now_ns)
            if self._unneeded(now_ns):
                return

    def close(self) -> None:
        """Close socket and bus."""
        self._server.close()
        self._cycle.close()

    @contextlib.contextmanager
    def _whatever_happens(self) -> Iterator[None]:
        """Log an exception of the block: a mistake in it must not stop the fan."""
        try:
            yield
        except Exception as error:
            self._log.say(f"internal error, the daemon goes on: {type(error).__name__}: {error}")

    def _serve_until(self, end_ns: int) -> None:
        while (left_ns := end_ns - time.monotonic_ns()) > 0:
            self._server.serve(left_ns / NS_PER_S, self._answer)

    def _unneeded(self, now_ns: int) -> bool:
        if now_ns >= self._next_look_ns:
            self._next_look_ns = now_ns + _LOOK_NS
            if self._emulation.is_over():
                self._log.say(f"{self._spec.bus} was emulated and is gone; so is the daemon")
                return True
        if self._stay or self._control.sent is not None or self._server.clients:
            self._used_ns = now_ns
        return now_ns - self._used_ns > _IDLE_NS

    def _left(self, pid: int) -> None:
        """Forget a client that has hung up."""
        self._setters.discard(pid)
        self._standbys.left(pid)

    def _answer(self, asked: Mapping[str, Any], peer: Peer) -> Mapping[str, Any]:
        """Carry out a client's request; raises `HilError` to refuse it."""
        now_ns, do = time.monotonic_ns(), asked.get("do")
        if do == "set":
            point = _point(asked)
            self._control.set_target(now_ns, point)
            self._setters.add(peer.pid)
            self._log_set_point(now_ns, str(peer), point)
            if self._cycle.sent_ns is None:
                self._cycle.step(now_ns)
        elif do == "off":
            why = asked.get("confirmed_by")
            if not isinstance(why, str) or not why.strip():
                raise UsageError(
                    "the fan is not stopped without a confirmation that the robot does not hang by it",
                    expected='"confirmed_by" and why nothing hangs by it',
                    remedy="`hil adhesion off --tethered`, or off the wall by load cells and IMU",
                )
            self._log.say(f"off, asked for by {peer}, confirmed: {why[:200]}")
            self._control.end(now_ns)
        elif do == "status":
            if asked.get("as") == "standby":
                self._standbys.heard(asked.get("pid"))
        else:
            raise UsageError(f"the daemon cannot {do!r}", expected="status, set or off", remedy=HOW_TO_ASK)
        return self._status(now_ns)

    def _log_set_point(self, now_ns: int, by: str, point: SetPoint) -> None:
        """Log a set-point and its sender; a bench that trims it all the time is logged once a minute."""
        asked = (by, point.quantity)
        if asked != self._asked or now_ns - self._asked_ns > _REPEAT_NS:
            self._asked, self._asked_ns = asked, now_ns
            self._log.say(f"set to {point.quantity} {point.value:g} by {by}")

    def _status(self, now_ns: int) -> dict[str, Any]:
        return {
            **self._cycle.status(now_ns),
            "pid": os.getpid(),
            "standby": self._standbys.pid if self._standbys.present(now_ns) else None,
            "set_by": sorted(self._setters),
            "since": self._began,
            "log": str(self._log.path or ""),
        }


def _point(asked: Mapping[str, Any]) -> SetPoint:
    """The set-point in a request; raises `UsageError`."""
    quantity, value = asked.get("quantity"), asked.get("value")
    if not isinstance(quantity, str) or isinstance(value, bool) or not isinstance(value, (int, float)):
        raise UsageError(
            f"a set-point for the daemon of {quantity!r} and {value!r}",
            expected="a quantity and a number",
            remedy=HOW_TO_ASK,
        )
    try:
        return SetPoint(quantity, float(value))
    except OverflowError:
        return SetPoint(quantity, math.inf)


def main(argv: list[str] | None = None) -> int:
    """Start a daemon; in the background unless it is to stay."""
    parser = argparse.ArgumentParser(prog="daemon", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("spec", help="the fan, as Spec.to_json writes it")
    parser.add_argument("--stay", action="store_true", help="in the foreground, also without a running fan")
    parser.add_argument(
        "--standby", action="store_true", help="wait until the running daemon ends, then take over"
    )
    parser.add_argument("--emulated", action="store_true", help="end with the emulator of the bus")
    parser.add_argument("--log", type=Path, help="log file; stderr when not given")
    given = parser.parse_args(argv)
    if not given.stay:
        detach()
    try:
        spec = Spec.from_json(given.spec)
        log = Log(given.log)
        ignore_signals(log.say)
        refused = harden()
        process = _opened(spec, log, given)
    except (HilError, OSError) as error:
        _print_line({"error": str(error)})
        return error.exit_code if isinstance(error, HilError) else EXIT_DEVICE
    if process is None:
        log.close()
        return 0
    log.say(f"daemon of {spec.name}, process {os.getpid()}" + f"; not permitted: {refused}" * bool(refused))
    _print_line({"pid": os.getpid()})
    if given.log is not None:
        _away_with(2)
    process.run()
    process.close()
    log.close()
    return 0


def _opened(spec: Spec, log: Log, given: argparse.Namespace) -> Process | None:
    """A daemon that owns its fan, for a standby once the other daemon is gone; None where not needed."""
    latest: Status = {}
    emulation = Emulation(spec.bus, known=given.emulated)
    while True:
        if emulation.is_over():
            gone, part = f"{spec.bus} was emulated and is gone", "standby" if given.standby else "daemon"
            log.say(f"{gone}; so is the {part}, process {os.getpid()}")
            _print_line({"error": gone})
            return None
        try:
            process = Process(spec, log, stay=given.stay, emulation=emulation)
        except TakenError:
            if not (given.stay or given.standby):
                raise
        else:
            process.go_on_from(latest)
            return process
        found = wait_as_standby(spec)
        if not found:  # the daemon is just ending; its socket name is free soon
            time.sleep(_NAME_FREE_S)
            continue
        latest = found
        if latest["state"] == "idle" and not given.stay:
            return None


def _print_line(content: Mapping[str, object]) -> None:
    """Print the one line for the parent process; then redirect stdin and stdout to the null device."""
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.write(json.dumps(content) + "\n")
        sys.stdout.flush()
    _away_with(0, 1)


def _away_with(*descriptors: int) -> None:
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in descriptors:
        os.dup2(nowhere, descriptor)
    os.close(nowhere)
