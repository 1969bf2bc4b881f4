"""What the computer under a benchmark does meanwhile."""

import os
from pathlib import Path


def stolen_s() -> float:
    """Processor time that the host of a virtual machine gave to others since it was started.

    Zero where the system does not give it (Linux does).
    """
    try:
        ticks = int(Path("/proc/stat").read_text().split("\n", 1)[0].split()[8])
    except (OSError, IndexError):
        return 0.0
    return ticks / os.sysconf("SC_CLK_TCK")
