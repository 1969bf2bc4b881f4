"""Every shipped procedure in every world, with the seed of the demo: its verdict, and what failed."""

from __future__ import annotations

import contextlib
import io
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

from two_worlds.bodies import WORLDS
from two_worlds.results import Row

from hil.cli import main
from hil.core.errors import EXIT_USAGE

SEED = 1
NAMES = (
    "bring_up",
    "steering_zero",
    "imu_calibration",
    "latency",
    "surface_identification",
    "tracker_extrinsics",
    "grid_scan",
    "odometry_calibration",
)
_FORM = {"odometry_calibration": ["--quick"]}
_SETTINGS: dict[str, list[str]] = {
    "own": [],
    "creep": ["bench.emulation.plant=mujoco", "bench.emulation.contact=creep"],
    "holding": ["bench.emulation.plant=mujoco", "bench.emulation.contact=holding"],
}


def keys() -> Iterator[Row]:
    """All procedures in all worlds."""
    for name in NAMES:
        for world in WORLDS:
            yield {"procedure": name, "world": world}


def run(procedure: str, world: str) -> Row:
    """One run: verdict, and each measurement that is not a pass with its value."""
    words = [*_FORM.get(procedure, []), *(w for setting in _SETTINGS[world] for w in ("--set", setting))]
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        code = main(["run", procedure, "--seed", str(SEED), "--out", folder, *words])
        if code == EXIT_USAGE:
            raise SystemExit(code)
        result = json.loads((Path(folder) / "result.json").read_text(encoding="utf-8"))
    if result["verdict"] == "ABORTED":
        raise KeyboardInterrupt(f"{procedure} was stopped: it says nothing of the world {world}")
    failed = [
        f"{m['name']} = {m['value']:.3g} {m['unit']}"
        for m in result["measurements"]
        if m["outcome"] not in ("PASS", "INFO", "pass", "info") and m["value"] is not None
    ]
    error = result.get("error")
    return {"verdict": result["verdict"], "failed": failed, "error": error and error["message"]}
