"""What commissioning brings, over many emulated robots as delivered.

`python benchmarks/commissioned_robots.py 0 1 2 3` commissions the robots of these seeds by the quick form and
prints ends and errors of their wall lines, nothing and everything known. `--full` takes the long form,
`--plant mujoco` the second physics, `--scale 0.75 1.3` cameras whose scale goes evenly from one to the other.
"""

import argparse
import json
import sys
import tempfile
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np

from hil.cli import main

NAMES = ("nothing known", "everything known")


def commissioned(seed, scale, folder, asked):
    words = ["commission", "--seed", str(seed), "--out", str(folder), "--json"]
    words += ["--set", f"bench.emulation.plant={asked.plant}"]
    words += ["--set", f"bench.emulation.tracker.scale={scale}"]
    said = StringIO()
    with redirect_stdout(said):
        code = main(words if asked.full else [*words, "--quick"])
    summary = json.loads(said.getvalue())
    if code != 0 or NAMES[1] not in summary.get("wall", {}):
        print(f"seed {seed}: exit code {code}, {summary.get('stopped') or summary.get('error')}", flush=True)
        return None
    return summary["wall"]


def row(wall):
    """End, RMSE x, RMSE y (mm) and heading (deg) of both lines, first with nothing known: (2, 2, 4)."""
    keys = (
        ("end_m", 1e3),
        ("rmse_x_m", 1e3),
        ("rmse_y_m", 1e3),
        ("rmse_heading_rad", float(np.degrees(1.0))),
    )
    return [[[f * wall[n][c][k] for k, f in keys] for c in ("x_line", "y_line")] for n in NAMES]


def run(words):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", type=int, nargs="+")
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--plant", choices=("own", "mujoco"), default="own")
    parser.add_argument("--scale", type=float, nargs=2, default=(1.0, 1.0), metavar=("FIRST", "LAST"))
    asked = parser.parse_args(words)
    seeds, found = asked.seeds, []
    for seed, scale in zip(seeds, np.linspace(*asked.scale, len(seeds)), strict=True):
        with tempfile.TemporaryDirectory() as scratch:
            wall = commissioned(seed, scale, Path(scratch) / "out", asked)
        if wall is not None:
            found.append(row(wall))
            ends = [
                f"{n}: X {found[-1][k][0][0]:.2f} mm, Y {found[-1][k][1][0]:.2f} mm"
                for k, n in enumerate(NAMES)
            ]
            print(f"seed {seed}, scale {scale:.3f}: " + "; ".join(ends), flush=True)
    if not found:
        return 1
    every = np.array(found)
    for k, name in enumerate(NAMES):
        for j, line in enumerate(("X", "Y")):
            ends, rest = every[:, k, j, 0], every[:, k, j, 1:]
            print(f"{name}, {line} line: end {np.sqrt(np.mean(ends**2)):.2f} mm rms, {ends.max():.2f} worst")
            x_mm, y_mm, heading_deg = rest.mean(axis=0)
            print(f"    means: RMSE x {x_mm:.2f} mm, y {y_mm:.2f} mm, heading {heading_deg:.3f} deg")
    return 0 if len(found) == len(seeds) else 1


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:]))
