"""Where the example package is, and how a process finds packages."""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "rangefinder"


def environment(*folders):
    """Variables of a process that finds this checkout, and packages in further folders."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (ROOT, *folders)))}
