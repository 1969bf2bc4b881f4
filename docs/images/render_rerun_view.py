"""Pictures and a clip of the Rerun view without a screen: a climb on the emulated wall, drawn in software.

    python docs/images/render_rerun_view.py

The robot drives up and to the left while its IMU is silent once. Rerun's viewer shows that without a
window, which needs Vulkan: of a graphics card, of Mesa (package mesa-vulkan-drivers), or the one that
Chromium brings (--vulkan names its folder).
"""

from __future__ import annotations

import argparse
import os
import socket
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import hil
from hil.core.clock import MonotonicClock, nanoseconds
from hil.core.signals import CycleRecord
from hil.monitor import Scene
from hil.monitor.rerun_stream import RerunStream
from hil.robot.trajectories import through

TABS = ("Motion", "Estimator", "Loop")
_CORNERS = ((0.0, 0.0, 0.0), (0.45, 0.0, 0.0), (0.45, 0.4, 0.0))
_FAULT = "imu:off@9+0.3"
_CHROMIUM = Path("/usr/lib/chromium")
_START_S, _DRAW_S, _TRIES = 60.0, 1.0, 5
_CLIP_WINDOW, _CLIP_PX, _CLIP_MS, _CLIP_QUALITY = "1100x760", 560, 120, 70


def climb() -> tuple[Scene, Sequence[CycleRecord]]:
    """The drive that is shown: scene and cycles."""
    trajectory = through([np.array(corner) for corner in _CORNERS])
    with hil.open_bench("emulated", seed=1, faults=[_FAULT]) as bench:
        motion = bench.drive(trajectory, feedback="ekf", observers=("odometry",))
        return Scene.of(bench.config, bench.geometry), motion.records


def play(scene: Scene, records: Sequence[CycleRecord], path: Path, tab: str) -> None:
    """The drive as the monitor shows it, with a tab in front."""
    stream = RerunStream((str(path),), scene, tab=tab)
    stream.path(np.array([r.reference.pose_in_wall[:2] for r in records[::10] if r.reference is not None]))
    for record in records:
        stream.add(record)
    stream.close()


@contextmanager
def viewer(vulkan: Path, size: str) -> Iterator[Any]:
    """A viewer without a window, and what asks it for pictures."""
    from rerun.experimental import ViewerClient

    spec = find_spec("rerun_cli")
    if spec is None or spec.origin is None:
        raise SystemExit("the program `rerun` is not installed: pip install rerun-sdk")
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    drivers = {"LD_LIBRARY_PATH": str(vulkan), "VK_ICD_FILENAMES": str(vulkan / "vk_swiftshader_icd.json")}
    command = [
        str(Path(spec.origin).with_name("rerun")),
        "--headless",
        "--bind",
        "127.0.0.1",
        "--port",
        str(port),
        "--renderer",
        "vulkan",
        "--window-size",
        size,
        "--hide-welcome-screen",
    ]
    process = subprocess.Popen(
        command, env=os.environ | (drivers if vulkan.is_dir() else {}), stderr=subprocess.DEVNULL
    )
    try:
        clock = MonotonicClock()
        deadline_ns = clock.now_ns() + nanoseconds(_START_S)
        while True:
            wait(0.5)
            try:
                yield ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
                return
            except ConnectionError:
                if process.poll() is not None or clock.now_ns() > deadline_ns:
                    raise SystemExit("the viewer does not start: is there a Vulkan driver?") from None
    finally:
        process.kill()
        process.wait()


def wait(seconds: float) -> None:
    """Let the viewer go on."""
    clock = MonotonicClock()
    clock.sleep_until_ns(clock.now_ns() + nanoseconds(seconds))


def photograph(client: Any, png: Path, t_s: float, view: str | None = None) -> None:
    """Save the window, or one of its views, at a time of the drive."""
    client.set_time("time", duration=t_s, play_state="paused")
    wait(_DRAW_S)
    for _ in range(_TRIES):
        with suppress(TimeoutError):
            client.save_screenshot(str(png.resolve()), view)
            return
    raise SystemExit(f"the viewer did not draw {png.name} in {_TRIES} tries: give the machine more time")


def clip(frames: Sequence[Path], path: Path) -> None:
    """Frames as an animated picture."""
    images = []
    for frame in frames:
        with Image.open(frame) as full:
            height = round(full.height * _CLIP_PX / full.width)
            images.append(full.convert("RGB").resize((_CLIP_PX, height), Image.Resampling.LANCZOS))
    images[0].save(
        path,
        save_all=True,
        append_images=images[1:],
        duration=_CLIP_MS,
        loop=0,
        quality=_CLIP_QUALITY,
        method=6,
    )


def main() -> None:
    """Draw the window with each tab, and the climb as a clip."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent)
    parser.add_argument("--vulkan", type=Path, default=_CHROMIUM, help="folder of a software Vulkan")
    parser.add_argument("--size", default="1600x900")
    parser.add_argument("--frames", type=int, default=50)
    options = parser.parse_args()
    scene, records = climb()
    end_s = (records[-1].inputs.t_ns - records[0].inputs.t_ns) / 1e9
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for tab in TABS:
            play(scene, records, folder / f"{tab}.rrd", tab)
            with viewer(
                options.vulkan, options.size
            ) as client:  # a viewer keeps the layout of its first file
                client.open(str(folder / f"{tab}.rrd"))
                photograph(client, options.out / f"rerun_{tab.lower()}.png", 0.6 * end_s)
        with viewer(options.vulkan, _CLIP_WINDOW) as client:
            client.open(str(folder / f"{TABS[0]}.rrd"))
            view = next(v.view_id for v in client.get_state().views if v.name.startswith("Robot"))
            frames = [folder / f"{k:03d}.png" for k in range(options.frames)]
            for k, frame in enumerate(frames):
                photograph(client, frame, end_s * k / (options.frames - 1), view)
        clip(frames, options.out / "robot_climbs.webp")


if __name__ == "__main__":
    main()
