"""Screenshots of the Rerun view without a screen: web viewer in headless Chromium, drawn in software.

    python docs/images/render_rerun_view.py recording.mcap --chromium /usr/bin/chromium

For each tab the recording is played into a file, served by `rerun --serve-web`, and photographed.
"""

from __future__ import annotations

import argparse
import socket
import subprocess
import sys
import tempfile
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path

import numpy as np

from hil.clock import MonotonicClock, nanoseconds
from hil.kinematics import WheelGeometry
from hil.monitor.blueprint import TABS
from hil.monitor.stream import RerunStream
from hil.recording.mcap_reader import read_header
from hil.recording.runs import RecordedRun, read_runs
from hil.trajectories import Trajectory

_START_S = 30.0
_VIRTUAL_MS = 40_000
_LIMIT_S = 240.0


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


def photograph(rrd: Path, png: Path, chromium: str, size: str) -> None:
    """Serve a file and take a picture of the page once it has been drawn."""
    web, grpc = free_port(), free_port()
    viewer = Path(sys.executable).parent / "rerun"
    command = [str(viewer), "--serve-web", "--bind", "127.0.0.1", "--port", str(grpc)]
    server = subprocess.Popen(
        [*command, "--web-viewer-port", str(web), str(rrd)], stdout=subprocess.DEVNULL, process_group=0
    )
    try:
        await_page(f"http://127.0.0.1:{web}/")
        source = urllib.parse.quote(f"rerun+http://127.0.0.1:{grpc}/proxy", safe="")
        subprocess.run(
            [
                chromium, "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--hide-scrollbars",
                "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
                f"--user-data-dir={rrd.parent / 'profile'}", f"--window-size={size}",
                f"--virtual-time-budget={_VIRTUAL_MS}", f"--screenshot={png}",
                f"http://127.0.0.1:{web}/?url={source}&renderer=webgl&theme=light",
            ],
            check=True, timeout=_LIMIT_S, stderr=subprocess.DEVNULL,
        )  # fmt: skip
    finally:
        subprocess.run(["kill", "--", f"-{server.pid}"], check=False)
        server.wait()


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
