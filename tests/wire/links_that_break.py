"""The ways to a device, each of which can be cut and mended: ports of other computers, and CAN adapters."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import subprocess
import sys
import threading
import time
import tty
from itertools import islice
from pathlib import Path

import can

from hil.fakes.free_port import free_udp_port
from tests.live.remote_bridges import Bridge, SocketCanDaemon

LATENCY_S = 0.002


class NetworkPort:
    """A serial port behind TCP."""

    def __init__(self, endpoint, protocol):
        self._endpoint, self._protocol, self._at = endpoint, protocol, 0
        self.mend()
        self.table = {"port": self._bridge.url, "baud": endpoint["baud"]}

    def mend(self):
        where = {"baud": self._endpoint["baud"], "latency_s": LATENCY_S, "protocol": self._protocol}
        self._bridge = Bridge(self._endpoint["port"], at=self._at, **where)
        self._at = self._bridge.at

    def cut(self):
        self._bridge.close()


class LocalPort:
    """A port of this computer, which cannot be cut."""

    cut = mend = None

    def __init__(self, endpoint):
        self.table = {"port": endpoint["port"], "baud": endpoint["baud"]}


def opened(endpoint):
    """A bus of python-can at an emulated one."""
    where = {key: endpoint[key] for key in ("interface", "channel", "port")}
    return can.Bus(**where, hop_limit=0)


class Multicast:
    """The emulated bus itself."""

    cut = mend = None

    def __init__(self, endpoint, folder):
        options = {"port": endpoint["port"], "hop_limit": 0}
        self.table = {"interface": endpoint["interface"], "channel": endpoint["channel"], "options": options}


class SocketCand:
    """A socketcand server."""

    def __init__(self, endpoint, folder):
        self._endpoint, self._at = endpoint, 0
        self.mend()
        options = {"host": "127.0.0.1", "port": self._at}
        self.table = {"interface": "socketcand", "channel": "can0", "options": options}

    def mend(self):
        self._daemon = SocketCanDaemon(opened(self._endpoint), latency_s=LATENCY_S, at=self._at)
        self._at = self._daemon.port

    def cut(self):
        self._daemon.close()


class Remote:
    """python-can-remote's own server; to cut it, it is killed."""

    def __init__(self, endpoint, folder):
        self._port = free_udp_port()
        self._words = ["--host", "127.0.0.1", "--port", str(self._port), "--interface", "udp_multicast"]
        self._words += ["--channel", endpoint["channel"]]
        self._environment = {**os.environ, "CAN_CONFIG": f'{{"port": {endpoint["port"]}, "hop_limit": 0}}'}
        self.mend()
        self.table = {"interface": "remote", "channel": f"127.0.0.1:{self._port}"}

    def mend(self):
        self._server = subprocess.Popen(
            [sys.executable, "-m", "can_remote", *self._words],
            env=self._environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        end_s = time.monotonic() + 20.0
        while not listens(self._port) and time.monotonic() < end_s:
            time.sleep(0.05)

    def cut(self):
        self._server.kill()
        self._server.wait(10)


def listens(port):
    wanted = f"0100007F:{port:04X} 00000000:0000 0A"
    return wanted in Path("/proc/net/tcp").read_text(encoding="ascii")


class Slcan:
    """An adapter that speaks slcan on a serial port (Lawicel's protocol), at a name that stays."""

    def __init__(self, endpoint, folder):
        self._endpoint, self._name = endpoint, folder / "adapter"
        self.mend()
        options = {"sleep_after_open": 0.1}
        self.table = {"interface": "slcan", "channel": str(self._name), "options": options}

    def mend(self):
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        self._name.symlink_to(os.ttyname(slave))
        self._slave, self._stop = slave, threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self):
        is_open = False
        with opened(self._endpoint) as bus:
            while not self._stop.is_set():
                first = bus.recv(0.01)
                if select.select([self._master], [], [], 0)[0]:
                    asked = os.read(self._master, 4096)
                    is_open = b"O\r" in asked or (is_open and b"C\r" not in asked)
                waiting = [] if first is None else [first, *islice(iter(lambda: bus.recv(0.0), None), 50)]
                lines = [
                    f"t{frame.arbitration_id:03X}{frame.dlc}{frame.data.hex().upper()}\r"
                    for frame in waiting
                    if is_open and not frame.is_extended_id
                ]
                with contextlib.suppress(BlockingIOError):
                    os.write(self._master, "".join(lines).encode())

    def cut(self):
        os.write(self._master, b"t1A0")  # pulled out in the middle of a line
        self._stop.set()
        self._thread.join(10)
        self._name.unlink()
        os.close(self._slave)
        os.close(self._master)
