"""The controller drives the emulated robot up its wall, also while the camera is blind."""

import json
import os
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hil import Bench
from hil.procedure.tracking_errors import enable_hold
from hil.robot.trajectories import line

NODE = "ros2 run wall_line wall_line --ros-args -p up_m:=0.2"
COMMAND = shlex.split(os.environ.get("WALL_LINE", NODE))
UP = np.array([0.2, 0.0, 0.0])
PROCEDURE = Path(__file__).parents[1] / "procedures" / "wall_line.py"


@pytest.fixture
def controller() -> Iterator[None]:
    """A new controller, ended with the test."""
    begun = subprocess.Popen(COMMAND)
    yield
    begun.terminate()
    begun.wait(timeout=30)


@pytest.mark.needs("servos", "mocap", "tracker")
@pytest.mark.controller("ros2:/joint_commands")
@pytest.mark.fault("tracker", "silent", at=4.0, duration=1.0)
def test_it_ends_where_it_should_through_a_blind_camera(controller: None, bench: Bench) -> None:
    """The estimate goes on by wheels and inertial unit meanwhile."""
    start = enable_hold(bench)
    motion = bench.drive(line(start, start + UP, duration_s=6.0), hold_s=2.0)
    assert np.hypot(*(motion.mocap[-1] - start - UP)[:2]) < 0.01
    bench.close()
    assert bench.held.state == "HELD"


def hil_run(out: Path, *options: str) -> tuple[int, dict]:
    """Exit code and result of the procedure."""
    words = ["run", str(PROCEDURE), "--controller", "ros2:/joint_commands", "--out", str(out), "--json"]
    done = subprocess.run([sys.executable, "-m", "hil", *words, *options], stdout=subprocess.PIPE, text=True)
    return done.returncode, json.loads(done.stdout)


def test_the_procedure_passes(controller: None, tmp_path: Path) -> None:
    """With a report in its folder, as `hil run` leaves it."""
    code, result = hil_run(tmp_path)
    assert code == 0, result["error"]
    assert result["held"]["state"] == "HELD"
    assert list(tmp_path.rglob("report.html"))


def test_without_its_controller_the_robot_is_held_and_the_run_says_why(tmp_path: Path) -> None:
    """A node that crashes as it starts must not pass."""
    code, result = hil_run(tmp_path, "--set", "bench.ros2.start_timeout_s=2")
    assert code == 3
    assert result["held"]["state"] == "HELD"
    assert "/joint_commands" in result["error"]["message"]
