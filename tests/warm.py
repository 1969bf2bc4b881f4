"""Commands of the `hil` command line without the second that a process takes to import everything.

Where a test asks for `warm_commands`, `python -m hil` or `pytest` is not started anew but forked from what
has imported it (tests/warm_template.py): a process of its own as before, with its own folder, environment,
streams, signals and exit code. Whatever else is started, and what would come out otherwise if it were
forked, is started as always: see `Warm._suits`. How the installed command starts is for the tests that do
not ask.
"""

import inspect
import os
import pickle
import socket
import subprocess
import sys
import threading
from pathlib import Path

from tests.warm_template import BESIDE, STATUS

MODULES = ("hil", "hil.cli", "pytest")
"""What is forked."""
READ_AT_START = ("PYTHON", "NUMBA_", "OPENBLAS_", "OMP_", "MPL", "LC_", "LANG", "TZ", "LD_")
"""Variables, by how their names begin, that an interpreter or a library reads once."""
UNUSUAL = ("preexec_fn", "pass_fds", "shell", "startupinfo", "gid", "gids", "uid")
"""Arguments of Popen that a forked command is not given."""

STARTED = subprocess.Popen
"""Popen as it is for everyone else."""
_names = tuple(inspect.signature(STARTED._execute_child).parameters)[1:]


def _words(command):
    """Module and arguments of `python -m MODULE ARGUMENTS`; no words of any other command."""
    if isinstance(command, (str, bytes, os.PathLike)) or len(command) < 2 or command[0] != sys.executable:
        return []
    how, *words = map(os.fspath, command[1:])
    if not how.startswith("-m"):
        return []
    return words if how == "-m" else [how[2:], *words]


def _read_at_start(environment):
    """What counts of an environment when a process begins, but for the folders of modules."""
    read = {name: value for name, value in environment.items() if name.startswith(READ_AT_START)}
    read.pop(BESIDE, None)
    return read


class Template:
    """The process that commands are forked from, started with the first of them; it ends with this one."""

    def __init__(self):
        self.environment = dict(os.environ)
        self._one_at_a_time = threading.Lock()
        self._process = self._control = None

    def _start(self):
        self._control, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with there:
            self._process = STARTED(
                [sys.executable, Path(__file__).with_name("warm_template.py"), str(there.fileno())],
                stdin=subprocess.DEVNULL,
                pass_fds=[there.fileno()],
                env=self.environment,
            )
        if not self._control.recv(1):
            raise RuntimeError(f"the template of warm commands ended with {self._process.wait()}")

    def fork(self, request, streams):
        """A new process: its id, and a descriptor that reports its wait status when it has ended."""
        status, reported = os.pipe()
        try:
            with self._one_at_a_time:
                if self._process is None:
                    self._start()
                socket.send_fds(self._control, [pickle.dumps(request)], [*streams, reported])
                answer = self._control.recv(STATUS.size)
                if not answer:
                    raise ConnectionResetError("what commands are forked from has ended")
                return STATUS.unpack(answer)[0], status
        finally:
            os.close(reported)

    def close(self):
        """End it; commands that still run are not touched."""
        if self._process is not None:
            self._control.close()
            self._process.wait()


class Asked(Template):
    """The same process as a command sees it that was forked from it.

    Args:
        place: address of its listening socket.
        environment: that with which it was started.
    """

    def __init__(self, place, environment):
        super().__init__()
        self.environment, self._place = environment, place

    def _start(self):
        self._control = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._control.connect(self._place)
        self._process = self._control


class Warm(STARTED):
    """`subprocess.Popen` that forks such commands from its template."""

    template = None
    _status = None

    @property
    def forked(self):
        """Whether it was."""
        return self._status is not None

    def _execute_child(self, *arguments):
        given = dict(zip(_names, arguments, strict=True))
        if not self._suits(given):
            super()._execute_child(*arguments)
            return
        wanted = (given["p2cread"], given["c2pwrite"], given["errwrite"])
        request = {
            "words": _words(given["args"]),
            "folder": os.path.abspath(given["cwd"] or "."),
            "environment": dict(os.environ if given["env"] is None else given["env"]),
            "session": given["start_new_session"],
        }
        streams = [standard if given_one == -1 else given_one for standard, given_one in enumerate(wanted)]
        try:
            self.pid, self._status = self.template.fork(request, streams)
        except OSError:  # a command that has outlived what it was forked from
            super()._execute_child(*arguments)
            return
        self._child_created = True
        pipes = ("p2cread", "p2cwrite", "c2pread", "c2pwrite", "errread", "errwrite")
        self._close_pipe_fds(*(given[name] for name in pipes))

    @classmethod
    def _suits(cls, given):
        """Whether it is a command that comes out of a fork as it would out of a new interpreter."""
        folder = os.path.abspath(given["cwd"] or ".")
        environment = os.environ if given["env"] is None else given["env"]
        return (
            hasattr(os, "pidfd_open")
            and _words(given["args"])[:1] in ([module] for module in MODULES)
            and not any(given.get(name) for name in UNUSUAL)
            and given["close_fds"]
            and given["umask"] == -1
            and given.get("process_group", -1) == -1
            and os.path.isdir(folder)
            and _read_at_start(environment) == _read_at_start(cls.template.environment)
        )

    def _try_wait(self, flags):
        if self._status is None:
            return super()._try_wait(flags)
        os.set_blocking(self._status, not flags & os.WNOHANG)
        try:
            reported = os.read(self._status, STATUS.size)
        except BlockingIOError:
            return 0, 0
        os.close(self._status)
        return self.pid, STATUS.unpack(reported)[0]

    def _internal_poll(self, _deadstate=None, **_):
        if self._status is None:
            return super()._internal_poll(_deadstate)
        if self.returncode is None and self._waitpid_lock.acquire(False):
            try:
                pid, status = self._try_wait(os.WNOHANG)
                if pid:
                    self._handle_exitstatus(status)
            finally:
                self._waitpid_lock.release()
        return self.returncode
