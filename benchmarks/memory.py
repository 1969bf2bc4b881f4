"""How the memory of a drive grows, kB per control cycle, and what an hour on the wall takes at most.

    python benchmarks/memory.py           a minute, then four minutes, at rest on the wall
    python benchmarks/memory.py --hour    a procedure of an hour on the wall, with recording and page

Everything runs in virtual time at 100 Hz. Ends with 1 above 1 kB per cycle, above 450 MB in the hour,
or where the hour was not driven to its end.
"""

from __future__ import annotations

import argparse
import gc
import json
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does

import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import hil

WANTED_KB, WANTED_MB = 1.0, 450.0
PER_CYCLE = "kB per further cycle"
BATTERY_AH = 100.0
WARM_UP_S, SHORT_S, LONG_S = 60.0, 60.0, 240.0
HOUR = '''"""Climb and descend for a while, and measure where the robot ends."""

import numpy as np
from hil.procedure import Context, Measurement, procedure
from hil.procedure.tracking_errors import enable_hold
from hil.robot.trajectories import line


@procedure(name="long_drive", needs=("servos", "mocap"),
           measurements=[Measurement("end_error", "mm", high=60.0, rationale="odometry sags")])
def run(ctx: Context) -> None:
    """Drive up slowly, for as long as asked."""
    start = enable_hold(ctx.bench)
    with ctx.step("drive", timeout_s=2.0 * DURATION):
        motion = ctx.bench.drive(line(start, start + [0.5, 0.0, 0.0], duration_s=DURATION), feedback="ekf")
    ctx.measure("end_error", 1e3 * float(np.abs(motion.mocap[-1, 0] - start[0] - 0.5)))
'''


def resident_mb() -> float:
    """Memory of this process that is in use now, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return 1e-6 * pages * resource.getpagesize()


def growth() -> dict[str, float]:
    """Growth of the process in two rests of different length, MB, and per further cycle, kB.

    What each drive keeps in memory for good, its newest 20 s, is in both.
    """
    grown_mb, cycles = [], []
    with hil.open_bench("emulated", seed=1) as bench:
        bench.observe(WARM_UP_S, feedback="ekf")
        for duration_s in (SHORT_S, LONG_S):
            gc.collect()
            before_mb = resident_mb()
            motion = bench.observe(duration_s, feedback="ekf")
            grown_mb.append(resident_mb() - before_mb)
            cycles.append(len(motion.records))
            del motion
    per_cycle_kb = 1e3 * (grown_mb[1] - grown_mb[0]) / (cycles[1] - cycles[0])
    return {
        f"MB in {SHORT_S:.0f} s": grown_mb[0],
        f"MB in {LONG_S:.0f} s": grown_mb[1],
        PER_CYCLE: per_cycle_kb,
    }


def hour(duration_s: float) -> dict[str, Any]:
    """Largest memory of `hil run` on a drive of that length, MB, and how the run ended."""
    with tempfile.TemporaryDirectory() as folder:
        script, out = Path(folder) / "long_drive.py", Path(folder) / "out"
        script.write_text(HOUR.replace("DURATION", repr(duration_s)), encoding="utf-8")
        battery = f"bench.emulation.adhesion.pack_ah={BATTERY_AH}"  # the profile's is empty after ten minutes
        command = [sys.executable, "-m", "hil", "run", str(script), "--out", str(out), "--set", battery]
        done = subprocess.run(
            command, check=False, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        most_mb = 1e-3 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
        result = out / "result.json"
        if not result.is_file():
            raise SystemExit(f"{' '.join(command)} ended with {done.returncode}:\n{done.stderr}")
        found = json.loads(result.read_text(encoding="utf-8"))
    ended = {"verdict": found["verdict"], "said": found["said"], "error": found["error"]}
    return {"asked_s": duration_s, **ended, "largest_mb": round(most_mb, 1)}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hour", nargs="?", const=3600.0, type=float, help="length of the long drive, s")
    asked = parser.parse_args()
    if asked.hour:
        found = hour(asked.hour)
        print(json.dumps(found, indent=1))
        return int(found["verdict"] not in ("PASS", "FAIL") or found["largest_mb"] > WANTED_MB)
    grown = growth()
    print(json.dumps({name: round(value, 2) for name, value in grown.items()}))
    return int(grown[PER_CYCLE] > WANTED_KB)


if __name__ == "__main__":
    sys.exit(main())
