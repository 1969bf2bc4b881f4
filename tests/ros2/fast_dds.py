"""Builds `wall_line_dds`, the controller of `examples/ros2` on plain Fast DDS, as its page says."""

import ctypes.util
import shutil
import subprocess
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[2] / "examples" / "ros2" / "fast_dds"
BUILD_S = 600
_NEEDED = "cmake, g++, libfastrtps-dev and libfastcdr-dev"


def build(folder):
    """The program, built in a folder as its page says; skips where the computer cannot."""
    lacking = [tool for tool in ("cmake", "g++") if shutil.which(tool) is None]
    lacking += [name for name in ("fastrtps", "fastcdr") if ctypes.util.find_library(name) is None]
    if lacking:
        pytest.skip(f"this computer lacks {', '.join(lacking)}: the program needs {_NEEDED}")
    made = subprocess.run(
        ["cmake", "-S", str(SOURCE), "-B", str(folder)], capture_output=True, text=True, timeout=BUILD_S
    )
    if "Could not find a package configuration file" in made.stderr:
        pytest.skip(f"the headers of Fast DDS 2 are not installed: the program needs {_NEEDED}")
    assert made.returncode == 0, made.stdout + made.stderr
    built = subprocess.run(["cmake", "--build", str(folder)], capture_output=True, text=True, timeout=BUILD_S)
    assert built.returncode == 0, built.stdout + built.stderr
    assert "warning:" not in built.stderr, built.stderr
    return folder / "wall_line_dds"
