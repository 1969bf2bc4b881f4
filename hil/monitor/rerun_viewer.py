"""Rerun's own program, started so that it listens to this computer only.

The library's `spawn`, `serve_web_viewer` and `GrpcServerSink` listen on every network interface and have no
option to change that; the program that comes with them has one.
"""

import ctypes
import importlib.util
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import urlsplit

from hil.core.errors import UsageError, reason_of

HOST = "127.0.0.1"
GRPC_PORT, WEB_PORT = 9876, 9090
LIVE = ("spawn", "connect", "serve")
"""Words for a viewer on this computer."""
SCHEMES = ("rerun+http", "rerun+https", "rerun")

_START_S, _POLL_S, _STOP_S, _ANSWER_S = 30.0, 0.05, 3.0, 2.0
_PR_SET_PDEATHSIG = 1


def url(port: int = GRPC_PORT) -> str:
    """URL of a viewer's port on this computer, to which a recording is sent."""
    return f"rerun+http://{HOST}:{port}/proxy"


def check_url(name: str) -> None:
    """Make sure that an address is one that Rerun sends recordings to.

    Raises:
        UsageError: another scheme or path, no host, or a port that none can have.
    """
    scheme, _, rest = name.partition("://")
    try:
        parts = urlsplit(name)
        usable = bool(parts.hostname) and parts.port != 0 and parts.path.rstrip("/") == "/proxy"
    except ValueError:
        usable = False
    if scheme in SCHEMES and usable:
        return
    near = f"rerun+{scheme}" if scheme in ("http", "https") else scheme if scheme in SCHEMES else "rerun+http"
    host = rest.partition("/")[0] or f"{HOST}:{GRPC_PORT}"
    raise UsageError(
        f"the monitor cannot open {name!r}",
        expected="a URL as " + ", ".join(f"{known}://HOST:PORT/proxy" for known in SCHEMES),
        remedy=f"did you mean {near}://{host}/proxy?",
    )


def answers(address: str) -> bool:
    """Whether a server listens at an address of Rerun; True also where it names no port."""
    parts = urlsplit(address)
    try:
        if parts.port is not None:
            socket.create_connection((parts.hostname or HOST, parts.port), _ANSWER_S).close()
    except OSError:
        return False
    return True


def spawn(port: int = GRPC_PORT) -> None:
    """Start the viewer, which outlives this process; one that listens already is used.

    Raises:
        RuntimeError: it cannot be started.
    """
    if not _listens(port):
        options = ["--port", str(port), "--hide-welcome-screen", "--expect-data-soon"]
        _await(_start(options, outlives=True), port)


def serve(grpc_port: int = GRPC_PORT, web_port: int = WEB_PORT) -> subprocess.Popen[bytes]:
    """Start a server of the viewer for browsers, which ends with this process at the latest.

    Raises:
        RuntimeError: it cannot be started.
    """
    for port in (grpc_port, web_port):
        if _listens(port):
            raise RuntimeError(f"port {port} is in use: another viewer or server is running")
    options = ["--serve-web", "--port", str(grpc_port), "--web-viewer-port", str(web_port)]
    process = _start(options, outlives=False)
    _await(process, grpc_port)
    _await(process, web_port)
    return process


def stop(process: subprocess.Popen[bytes]) -> None:
    """End a server process."""
    process.terminate()
    try:
        process.wait(_STOP_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _start(options: list[str], *, outlives: bool) -> subprocess.Popen[bytes]:
    quiet = os.environ | {"RERUN_APP_ONLY": "true"}  # as the library does: no welcome, no questions
    command = [_program(), "--bind", HOST, *options]
    try:
        return subprocess.Popen(
            command,
            env=quiet,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            start_new_session=outlives,
            preexec_fn=None if outlives else _end_with_parent,
        )
    except OSError as error:
        raise RuntimeError(f"{command[0]} cannot be started ({reason_of(error)})") from None


def _program() -> str:
    spec = importlib.util.find_spec("rerun_cli")
    own = Path(spec.origin).with_name("rerun") if spec is not None and spec.origin else Path()
    found = str(own) if own.is_file() else shutil.which("rerun")
    return os.environ.get("RERUN_CLI_PATH") or found or "rerun"


def _end_with_parent() -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)


def _listens(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        return probe.connect_ex((HOST, port)) == 0


def _await(process: subprocess.Popen[bytes], port: int) -> None:
    end_s = time.monotonic() + _START_S
    while not _listens(port):
        if process.poll() is not None or time.monotonic() > end_s:
            process.kill()
            raise RuntimeError(f"the viewer does not listen on port {port} (see its message above)")
        time.sleep(_POLL_S)
