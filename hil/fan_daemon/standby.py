"""The daemon's standby: a second process that reads what the first sends, and takes over when it is gone.

It polls the daemon's status over the same socket as all clients. The kernel hangs up for a process that
dies, so the standby detects it within microseconds, whatever else this computer does.
"""

import json
import os
import select
import subprocess
import time
from collections.abc import Callable, Sequence

from hil.core.clock import nanoseconds
from hil.fan_daemon import client
from hil.fan_daemon.server import MOST_BYTES
from hil.fan_daemon.spec import Spec

_ASK_S = 0.025
_AGAIN_NS, _ABSENT_NS = nanoseconds(5.0), nanoseconds(1.0)
_LASTING_NS = nanoseconds(0.1)
"""After a shorter life the next standby is started later: the same cause would end it, too."""


def wait_as_standby(spec: Spec) -> client.Status:
    """Wait until the daemon of a fan is gone; returns its last status, empty where none answers."""
    connection = client.connect(spec)
    if connection is None:
        return {}
    request = json.dumps({"do": "status", "as": "standby", "pid": os.getpid()}).encode()
    latest: client.Status = {}
    with connection:
        connection.settimeout(None)  # a daemon that hangs still owns the fan's socket name
        while True:
            try:
                connection.send(request)
                packet = connection.recv(MOST_BYTES)
                said = json.loads(packet) if packet else {}
                if "error" in said:  # the daemon has too many clients
                    return latest
                latest = said or latest
                if not packet or select.select([connection], [], [], _ASK_S)[0]:
                    return latest
            except OSError:
                return latest


class StandbyStarter:
    """Starts a standby of a daemon whenever there is none.

    Args:
        spec: the fan.
        command: command line of a standby.
        say: function that logs a line of text for each standby that connects or disconnects.

    Attributes:
        pid: process id of the latest standby; None once it has disconnected.
    """

    def __init__(self, spec: Spec, command: Sequence[str], say: Callable[[str], None]) -> None:
        self._whose, self._command, self._say = spec.whose, tuple(command), say
        self._starting: subprocess.Popen[bytes] | None = None
        self._asked_ns: int | None = None
        self._came_ns = self._due_ns = 0
        self.pid: int | None = None

    def heard(self, pid: object) -> None:
        """Note that the standby `pid` has requested the status."""
        self._asked_ns = time.monotonic_ns()
        if isinstance(pid, int) and pid != self.pid:
            self.pid, self._came_ns = pid, self._asked_ns
            self._say(f"{self._whose} daemon has a standby, process {pid}")

    def left(self, pid: int) -> None:
        """A client has disconnected. A new standby is due at once, unless this one had just connected."""
        if pid == self.pid:
            self._say_another_starts("is gone")
            self.pid = self._asked_ns = None
            if time.monotonic_ns() - self._came_ns >= _LASTING_NS:
                self._due_ns = 0

    def present(self, now_ns: int) -> bool:
        """Whether there is one now."""
        return self._asked_ns is not None and now_ns - self._asked_ns < _ABSENT_NS

    def start_if_missing(self, now_ns: int) -> None:
        """Start a standby where there is none; never waits for it."""
        if now_ns < self._due_ns or self.present(now_ns):
            return
        if self.pid is not None:
            self._say(f"the standby of {self._whose} daemon, process {self.pid}, hangs; another is started")
            self.pid = None
        self._due_ns = now_ns + _AGAIN_NS
        if self._starting is not None:
            self._starting.poll()
        nowhere = subprocess.DEVNULL
        self._starting = subprocess.Popen(
            self._command, stdin=nowhere, stdout=nowhere, stderr=nowhere, start_new_session=True
        )

    def _say_another_starts(self, what: str) -> None:
        self._say(f"the standby of {self._whose} daemon, process {self.pid}, {what}; another is started")
