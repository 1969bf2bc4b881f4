"""The keeper's understudy: a second process that knows what the first sends, and goes on when that is gone.

It asks for the keeper's status all the time, over the same socket as everybody. The kernel hangs up for a
process that dies, so it knows within microseconds, whatever else this computer does.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import time
from collections.abc import Callable, Sequence

from hil.core.clock import nanoseconds
from hil.drivers.adhesion.keeper import client
from hil.drivers.adhesion.keeper.door import MOST_BYTES
from hil.drivers.adhesion.keeper.spec import Spec

_ASK_S = 0.025
_AGAIN_NS, _ABSENT_NS = nanoseconds(5.0), nanoseconds(1.0)
_LASTING_NS = nanoseconds(0.1)
"""Those that end sooner are started at the slow pace: whatever ends them would end the next."""


def stand_beside(spec: Spec) -> client.Status:
    """Wait until the keeper of a fan is gone; its last status: none where there is none that answers."""
    connection = client.connect(spec)
    if connection is None:
        return {}
    request = json.dumps({"do": "status", "as": "understudy", "pid": os.getpid()}).encode()
    latest: client.Status = {}
    with connection:
        connection.settimeout(None)  # a keeper that hangs has not let go of the fan's name
        while True:
            try:
                connection.send(request)
                packet = connection.recv(MOST_BYTES)
                said = json.loads(packet) if packet else {}
                if "error" in said:  # it has no room for one more
                    return latest
                latest = said or latest
                if not packet or select.select([connection], [], [], _ASK_S)[0]:
                    return latest
            except OSError:
                return latest


class Understudies:
    """Sees to it that a keeper has an understudy.

    Args:
        spec: what is kept.
        command: starts one.
        say: told in words which come and go.

    Attributes:
        pid: of the latest that has asked; None where it has hung up.
    """

    def __init__(self, spec: Spec, command: Sequence[str], say: Callable[[str], None]) -> None:
        self._whose, self._command, self._say = spec.whose, tuple(command), say
        self._starting: subprocess.Popen[bytes] | None = None
        self._asked_ns: int | None = None
        self._came_ns = self._due_ns = 0
        self.pid: int | None = None

    def heard(self, pid: object) -> None:
        """One has asked for the status."""
        self._asked_ns = time.monotonic_ns()
        if isinstance(pid, int) and pid != self.pid:
            self.pid, self._came_ns = pid, self._asked_ns
            self._say(f"{self._whose} keeper has an understudy, process {pid}")

    def left(self, pid: int) -> None:
        """A client has hung up. Another understudy is due at once, unless this one had only just come."""
        if pid == self.pid:
            self._tell_of_another("is gone")
            self.pid = self._asked_ns = None
            if time.monotonic_ns() - self._came_ns >= _LASTING_NS:
                self._due_ns = 0

    def present(self, now_ns: int) -> bool:
        """Whether there is one now."""
        return self._asked_ns is not None and now_ns - self._asked_ns < _ABSENT_NS

    def see_to_one(self, now_ns: int) -> None:
        """Start one where there is none; never waits for it."""
        if now_ns < self._due_ns or self.present(now_ns):
            return
        if self.pid is not None:
            self._say(
                f"the understudy of {self._whose} keeper, process {self.pid}, hangs; another is started"
            )
            self.pid = None
        self._due_ns = now_ns + _AGAIN_NS
        if self._starting is not None:
            self._starting.poll()
        nowhere = subprocess.DEVNULL
        self._starting = subprocess.Popen(
            self._command, stdin=nowhere, stdout=nowhere, stderr=nowhere, start_new_session=True
        )

    def _tell_of_another(self, what: str) -> None:
        self._say(f"the understudy of {self._whose} keeper, process {self.pid}, {what}; another is started")
