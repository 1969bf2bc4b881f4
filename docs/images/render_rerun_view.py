"""Screenshots of the Rerun view without a screen: web viewer in headless Chromium, drawn in software.

    python docs/images/render_rerun_view.py recording.mcap --chromium /usr/bin/chromium

For each tab the recording is played into a file, served by `rerun --serve-web`, and photographed.
"""

from __future__ import annotations

import argparse
import base64
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np

from hil.monitor.blueprint import TABS
from hil.monitor.stream import RerunStream
from hil.recording.mcap_reader import read_header
from hil.recording.runs import RecordedRun, read_runs
from hil.robot.kinematics import WheelGeometry
from hil.robot.trajectories import Trajectory
from hil.vocabulary.clock import MonotonicClock, nanoseconds

_START_S = 30.0
_DRAWN_BYTES = 50_000
_BETWEEN_S = 15.0
_PICTURES = 18
_ALIKE = 0.02


def free_port() -> int:
    """A TCP port on this host that nobody uses."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port: int = server.getsockname()[1]
        return port


def play(run: RecordedRun, geometry: WheelGeometry, path: Path, tab: str) -> None:
    """One run as the monitor shows it, with a tab in front."""
    stream = RerunStream((str(path),), geometry, tab=tab)
    if run.start is not None and run.start.trajectory is not None:
        trajectory = Trajectory.from_mapping(run.start.trajectory)
        times_s = np.linspace(0.0, trajectory.duration_s, 400)
        stream.path(np.array([trajectory.sample(float(t)).pose_in_wall[:2] for t in times_s]))
    for record in run.records:
        stream.add(record)
    stream.close()


class Browser:
    """Headless Chromium, spoken to over its debugging pipe."""

    def __init__(self, chromium: str, size: str, folder: Path) -> None:
        child_in, self._out = os.pipe()
        self._in, child_out = os.pipe()
        width, _, height = size.partition(",")
        arguments = [
            chromium, "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--hide-scrollbars",
            "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
            f"--user-data-dir={folder / 'profile'}", f"--window-size={width},{height}",
            "--remote-debugging-pipe", "about:blank",
        ]  # fmt: skip
        self._child = subprocess.Popen(
            ["bash", "-c", f'exec "$@" 3<&{child_in} 4>&{child_out}', "bash", *arguments],
            pass_fds=(child_in, child_out), stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        os.close(child_in)
        os.close(child_out)
        self._number, self._rest = 0, b""

    def ask(self, method: str, session: str | None = None, **parameters: Any) -> Any:
        """Result of one command."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if session is not None:
            message["sessionId"] = session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = json.loads(self._next())
            if answer.get("id") == self._number:
                return answer["result"]

    def _next(self) -> bytes:
        while b"\0" not in self._rest:
            piece = os.read(self._in, 1 << 20)
            if not piece:
                raise SystemExit("the browser has ended")
            self._rest += piece
        message, self._rest = self._rest.split(b"\0", 1)
        return message

    def close(self) -> None:
        """End it."""
        os.killpg(self._child.pid, signal.SIGKILL)
        self._child.wait()
        os.close(self._in)
        os.close(self._out)


def photograph(rrd: Path, png: Path, chromium: str, size: str) -> None:
    """Serve a file, show it, and take pictures until the last two are as large as each other."""
    web, grpc = free_port(), free_port()
    viewer = Path(sys.executable).parent / "rerun"
    command = [str(viewer), "--serve-web", "--bind", "127.0.0.1", "--port", str(grpc)]
    server = subprocess.Popen(
        [*command, "--web-viewer-port", str(web), str(rrd)],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    try:
        await_page(f"http://127.0.0.1:{web}/")
        source = urllib.parse.quote(f"rerun+http://127.0.0.1:{grpc}/proxy", safe="")
        browser = Browser(chromium, size, rrd.parent)
        try:
            url = f"http://127.0.0.1:{web}/?url={source}&renderer=webgl&theme=light"
            png.write_bytes(picture(browser, url))
        finally:
            browser.close()
    finally:
        os.killpg(server.pid, signal.SIGKILL)
        server.wait()


def picture(browser: Browser, url: str) -> bytes:
    """PNG of a page that has been drawn."""
    clock = MonotonicClock()
    target = browser.ask("Target.createTarget", url=url)["targetId"]
    session = browser.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
    before = 0
    for _ in range(_PICTURES):
        clock.sleep_until_ns(clock.now_ns() + nanoseconds(_BETWEEN_S))
        found = base64.b64decode(browser.ask("Page.captureScreenshot", session, format="png")["data"])
        if len(found) > _DRAWN_BYTES and abs(len(found) - before) < _ALIKE * len(found):
            return found
        before = len(found)
    raise SystemExit(f"{url}: the page was not drawn within {_PICTURES * _BETWEEN_S:g} s")


def await_page(url: str) -> None:
    """Wait until a page is served."""
    clock = MonotonicClock()
    deadline_ns = clock.now_ns() + nanoseconds(_START_S)
    while clock.now_ns() < deadline_ns:
        try:
            with urllib.request.urlopen(url, timeout=1.0):
                return
        except (urllib.error.URLError, OSError):
            clock.sleep_until_ns(clock.now_ns() + nanoseconds(0.2))
    raise SystemExit(f"{url} is not served")


def main() -> None:
    """Render one picture per tab."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent)
    parser.add_argument("--chromium", default="chromium")
    parser.add_argument("--tabs", nargs="*", default=list(TABS))
    parser.add_argument("--size", default="1600,900")
    options = parser.parse_args()
    geometry = WheelGeometry.from_vector(np.array(read_header(options.recording)["geometry"]))
    run = max(read_runs(options.recording), key=lambda r: len(r.records))
    with tempfile.TemporaryDirectory() as folder:
        for tab in options.tabs:
            rrd = Path(folder) / f"{tab}.rrd"
            play(run, geometry, rrd, tab)
            photograph(rrd, options.out / f"rerun_{tab.lower()}.png", options.chromium, options.size)


if __name__ == "__main__":
    main()
