"""How well calibration reads wheels whose law of contact is not among its own.

    python benchmarks/slip_laws.py 9500:9520

Each seed is a robot of `tests/calibration/spoilt_sets.py`: wheels that creep with their load, hold by dry
friction, lose a part of their way to load and pull, or both of these, with bursts of sliding and chance from
run to run. It is calibrated on its recordings. Then the same robot drives every motion without chance, and
odometry by the result is compared with where it went: `recorded` are the motions of the recordings, `others`
all other ones. RMSE of the position in mm, means over the motions, and the worst motion.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hil.calibration.calibrate import calibrate
from hil.calibration.evaluation import position_rmse, track_all
from hil.calibration.problem import make_setting
from hil.core.clock import MonotonicClock
from hil.datasets.read import read_recordings
from tests.calibration.spoilt_sets import Drive, drives_without_chance, make_drives


def read(drives: list[Drive]) -> list:
    """The recordings, as files are read."""
    with tempfile.TemporaryDirectory() as folder:
        for drive in drives:
            drive.write(Path(folder))
        return read_recordings([Path(folder)])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("seeds", help="FIRST:END")
    first, end = map(int, parser.parse_args().seeds.split(":"))
    print("seed law   model          clear  recorded  worst | others  worst | apart, most")
    rows = []
    for seed in range(first, end):
        recordings = read(make_drives(seed))
        result = calibrate(recordings, make_setting("recommended"), MonotonicClock())
        law, drives = drives_without_chance(seed)
        known = {r.name.rsplit("_", 1)[0] for r in recordings}
        tracks = track_all(read(drives), result.geometry, result.setting.model, result.setting.signal)
        errors = {t.recording.name.rsplit("_", 1)[0]: 1e3 * position_rmse(t) for t in tracks}
        own = [e for name, e in errors.items() if name in known]
        others = [e for name, e in errors.items() if name not in known]
        clear = bool(result.choice) and not result.choice.rivals
        apart = 1e3 * max(result.apart_m.values(), default=0.0)
        rows.append((np.mean(own), max(own), np.mean(others), max(others)))
        print(
            f"{seed} {law:5}  {result.setting.model:13}  {'yes' if clear else 'no':5}  {rows[-1][0]:8.2f} "
            f"{rows[-1][1]:6.2f} | {rows[-1][2]:6.2f} {rows[-1][3]:6.2f} | {apart:.1f}",
            flush=True,
        )
    print("mean " + "  ".join(f"{v:.2f}" for v in np.mean(rows, axis=0)))
    print("worst " + "  ".join(f"{v:.2f}" for v in np.max(rows, axis=0)))


if __name__ == "__main__":
    main()
