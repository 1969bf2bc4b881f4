"""Where the example package is, and how a folder gets it."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "rangefinder"


def environment(*folders):
    """Variables of a process that finds this checkout, and packages in further folders."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (ROOT, *folders)))}


def install(folder, target):
    """Install the package of a folder into another folder; nothing is asked of the network."""
    options = ("--quiet", "--no-index", "--no-deps", "--no-build-isolation", "--disable-pip-version-check")
    subprocess.run(
        [sys.executable, "-m", "pip", "install", *options, "--target", str(target), str(folder)], check=True
    )
