"""What the project starts that listens: to this computer only, unless an option asks for more."""

import importlib.util
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from hil.monitor import rerun_viewer

needs_rerun = pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="Rerun is not installed")
needs_proc = pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="no /proc/net on this system")
LOOPBACK = "0100007F"


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def addresses(port, table="tcp"):
    """Local addresses, as the kernel writes them, on which a program listens on a port."""
    found = []
    for name in (table, table + "6"):
        for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]:
            address, number = line.split()[1].split(":")
            if int(number, 16) == port and (table == "udp" or line.split()[3] == "0A"):
                found.append(address)
    return set(found)


@needs_rerun
@needs_proc
def test_the_server_for_browsers_listens_to_this_computer_only():
    grpc_port, web_port = free_port(), free_port()
    process = rerun_viewer.serve(grpc_port, web_port)
    try:
        assert addresses(grpc_port) == {LOOPBACK}
        assert addresses(web_port) == {LOOPBACK}
        with pytest.raises(RuntimeError, match=f"port {grpc_port} is in use"):
            rerun_viewer.serve(grpc_port, web_port)
    finally:
        rerun_viewer.stop(process)
    assert addresses(grpc_port) == addresses(web_port) == set()


@needs_rerun
@needs_proc
def test_a_stream_that_serves_takes_records_and_ends_its_server(monkeypatch, capfd):
    from test_monitor_sink import shown

    from hil.monitor import Scene
    from hil.monitor.rerun_stream import RerunStream

    grpc_port, web_port = free_port(), free_port()
    monkeypatch.setattr(rerun_viewer, "url", lambda: f"rerun+http://127.0.0.1:{grpc_port}/proxy")
    serve = rerun_viewer.serve
    monkeypatch.setattr(rerun_viewer, "serve", lambda: serve(grpc_port, web_port))
    monkeypatch.setattr(rerun_viewer, "WEB_PORT", web_port)
    stream = RerunStream(("serve",), Scene())
    assert addresses(grpc_port) == addresses(web_port) == {LOOPBACK}
    for k in range(50):
        stream.add(shown(k))
    stream.close()
    assert addresses(grpc_port) == addresses(web_port) == set()
    assert f"http://127.0.0.1:{web_port}" in capfd.readouterr().err


@needs_rerun
@needs_proc
def test_a_server_ends_with_the_process_that_started_it():
    grpc_port, web_port = free_port(), free_port()
    serve = f"viewer.serve({grpc_port}, {web_port})"
    code = f"import os; from hil.monitor import rerun_viewer as viewer; {serve}; os.kill(os.getpid(), 9)"
    done = subprocess.run([sys.executable, "-c", code], check=False, env=os.environ, timeout=120)
    assert done.returncode == -9, "it was served until then"
    for _ in range(200):
        if not addresses(grpc_port):
            return
        with socket.socket() as wait:
            wait.settimeout(0.05)
            wait.connect_ex(("127.0.0.1", grpc_port))
    assert not addresses(grpc_port)
