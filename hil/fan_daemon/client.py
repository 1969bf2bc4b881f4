"""Client of the fan daemon: finds or starts it, and sends requests, blocking or without waiting."""

import contextlib
import json
import os
import pwd
import re
import select
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hil.core.errors import EXIT_USAGE, DeviceError, UsageError
from hil.fan_daemon.fan_control import SetPoint
from hil.fan_daemon.server import MOST_BYTES, address, may_ask, of_another, peer, user
from hil.fan_daemon.spec import Spec
from hil.support.emulated_can_mark import is_emulated
from hil.support.file_reading import json_object

DAEMON = (sys.executable, "-m", "hil.fan_daemon")
_START_S = 15.0
_ANSWER_S = 2.0
_AGAIN_S = 0.01
_REMEDY = "`hil adhesion on` starts one"

Status = Mapping[str, Any]
Request = Mapping[str, object]


def connect(spec: Spec) -> socket.socket | None:
    """A connection to the daemon of a fan; None where there is none.

    Raises:
        DeviceError: it belongs to another user, or takes no more clients.
    """
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    connection.settimeout(_ANSWER_S)
    try:
        _queue(connection, spec)
        owner = peer(connection).uid
    except ConnectionRefusedError:
        connection.close()
        return None
    except OSError as error:
        connection.close()
        raise DeviceError(
            spec.device,
            f"{spec.whose} daemon cannot be reached ({error})",
            port=spec.name,
            remedy="end programs that talk to it and try again",
        ) from None
    if not may_ask(os.getuid(), owner):
        connection.close()
        raise of_another(spec, _named(owner), _named(os.getuid()))
    return connection


def _named(uid: int) -> str:
    """A user by name and number; by number alone where this computer has no name for it."""
    try:
        return "root" if uid == 0 else f"user {pwd.getpwuid(uid).pw_name} ({uid})"
    except KeyError:
        return user(uid)


def of_whom(status: Status) -> str:
    """Part of a message such as ` of user robot (1000)`; empty for a daemon of our own user."""
    uid = status.get("uid", os.getuid())
    return "" if uid == os.getuid() else f" of {_named(uid)}"


def _queue(connection: socket.socket, spec: Spec) -> None:
    """Connect; retried while the daemon's queue of connections is full."""
    patient_until_s = time.monotonic() + _ANSWER_S
    while True:
        try:
            return connection.connect(address(spec))
        except BlockingIOError:
            if time.monotonic() >= patient_until_s:
                raise
            time.sleep(_AGAIN_S)


def ask(connection: socket.socket, request: Mapping[str, object], spec: Spec) -> Status:
    """Send a request and wait for the answer; the status gets `uid`, the user that the daemon runs as.

    Raises:
        UsageError, DeviceError: it was refused, or the daemon does not answer.
    """
    try:
        with contextlib.suppress(BrokenPipeError):  # a refused client finds the reason in its buffer
            connection.send(json.dumps(request).encode())
        packet = connection.recv(MOST_BYTES)
        if not packet:
            raise ConnectionResetError("it closed the connection")
    except OSError as error:
        raise DeviceError(
            spec.device, f"{spec.whose} daemon does not answer ({error})", port=spec.name, remedy=_REMEDY
        ) from None
    return {**understood(packet, spec), "uid": peer(connection).uid}


def understood(packet: bytes, spec: Spec) -> Status:
    """The daemon's answer, parsed.

    Raises:
        UsageError, DeviceError: the refusal that it contains, or an answer that cannot be parsed.
    """
    try:
        answer = json_object(packet)
        error = answer.get("error")
        if error is None:
            return answer
        code, message, expected, remedy = (
            error[key] for key in ("exit_code", "message", "expected", "remedy")
        )
        if not all(isinstance(text, str) for text in (message, expected, remedy)):
            raise ValueError("an error consists of texts")
    except (ValueError, TypeError, KeyError):
        raise DeviceError(
            spec.device,
            f"{spec.whose} daemon answered what cannot be understood",
            port=spec.name,
            expected="an answer of the same version of hil",
            remedy="see `hil adhesion status`; a daemon of another version goes on until `hil adhesion off`",
        ) from None
    if code == EXIT_USAGE:
        raise UsageError(message, expected=expected, remedy=remedy)
    reported = message.partition(": ")[2] or message
    raise DeviceError(spec.device, reported, port=spec.name, expected=expected, remedy=remedy)


def set_request(point: SetPoint) -> dict[str, object]:
    """The request for a set-point."""
    return {"do": "set", "quantity": point.quantity, "value": point.value}


def off_request(confirmed_by: str) -> dict[str, object]:
    """The request to let the fan come to rest."""
    return {"do": "off", "confirmed_by": confirmed_by}


def log_path(spec: Spec) -> Path:
    """Path of the log of a fan's daemon."""
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(base) / "hil" / f"adhesion-{re.sub('[^A-Za-z0-9.]+', '-', spec.name)}.log"


class DaemonLaunch:
    """A daemon process that is starting, and outlives this one.

    Args:
        spec: the fan.
        emulated: True if its bus is known to be emulated: the daemon then ends with the emulator, or does not
            begin. Its own check would be too late if the emulator ended while the daemon starts.
    """

    def __init__(self, spec: Spec, *, emulated: bool) -> None:
        self._spec = spec
        command = [*DAEMON, spec.to_json()]
        command += ["--emulated"] if emulated else []
        command += ["--log", str(log_path(spec).absolute())]
        paths = os.pathsep.join(os.path.abspath(p) for p in sys.path if p)
        self._child = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            env={**os.environ, "PYTHONPATH": paths},
        )
        self._text = b""

    def first_line(self, timeout_s: float) -> dict[str, Any] | None:
        """Its first line of output, with `pid` or `error`, within `timeout_s`; None before it has come."""
        assert self._child.stdout is not None
        descriptor = self._child.stdout.fileno()
        end_s = time.monotonic() + timeout_s
        while select.select([descriptor], [], [], max(0.0, end_s - time.monotonic()))[0]:
            piece = os.read(descriptor, 4096)
            self._text += piece
            lines = self._text.decode(errors="replace").strip().splitlines() or ["it ended without output"]
            with contextlib.suppress(ValueError):
                said = json_object(lines[-1].encode())
                self.leave()
                return said
            if not piece:
                self.leave()
                return {"error": lines[-1]}
        return None

    def leave(self) -> None:
        """Close the pipe to the daemon, after its first line or once that is not awaited. Idempotent."""
        if self._child.stdout is not None:
            self._child.stdout.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._child.wait(0.5)


def find_or_start(spec: Spec) -> socket.socket:
    """A connection to the daemon of a fan, which is started where there is none.

    Raises:
        DeviceError: none can be started.
    """
    found = connect(spec)
    if found is not None:
        return found
    starting = DaemonLaunch(spec, emulated=is_emulated(spec.bus))
    said = starting.first_line(_START_S) or {"error": f"no output for {_START_S:g} s"}
    starting.leave()
    found = connect(spec)
    if found is None:
        raise DeviceError(
            spec.device,
            f"{spec.whose} daemon did not start: {said.get('error', 'it has ended')}",
            port=spec.name,
            remedy=f"look at {log_path(spec)}",
        )
    return found


class Connection:
    """A non-blocking connection.

    Args:
        connection: connection to the daemon.
        t_ns: present time.

    Attributes:
        since_ns: time at which it began; `answered_ns`: time of the daemon's last answer.
        asked: the pending request; None for none.
        uid: the user that the daemon runs as.
    """

    def __init__(self, connection: socket.socket, t_ns: int) -> None:
        connection.setblocking(False)
        self._socket = connection
        self.since_ns = self.answered_ns = t_ns
        self.asked: Request | None = None
        self.uid = peer(connection).uid

    def ask(self, request: Request) -> None:
        """Send a request, unless an answer is awaited; raises `OSError` where the daemon has hung up."""
        if self.asked is None:
            self.asked = request
            self._socket.send(json.dumps(request).encode())

    def answer(self, t_ns: int) -> tuple[Request, bytes] | None:
        """(request, answer), once; None before it has come.

        Raises:
            OSError: the daemon has hung up (ConnectionResetError), or cannot be reached.
        """
        if self.asked is None:
            return None
        try:
            packet = self._socket.recv(MOST_BYTES)
        except BlockingIOError:
            return None
        if not packet:
            raise ConnectionResetError("the daemon has closed the connection")
        asked, self.asked, self.answered_ns = self.asked, None, t_ns
        return asked, packet

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()
