"""The controller drives the emulated robot up its wall, also while the camera is blind."""

import json
import os
import shlex
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

NODE = "ros2 run wall_line wall_line --ros-args -p up_m:=0.2"
CONTROLLER = shlex.split(os.environ.get("WALL_LINE", NODE))
TOPIC = "/joint_commands"
PROCEDURE = Path(__file__).parents[1] / "procedures" / "wall_line.py"


@contextmanager
def controller() -> Iterator[None]:
    """A new controller, ended afterwards."""
    begun = subprocess.Popen(CONTROLLER)
    try:
        yield
    finally:
        begun.terminate()
        begun.wait(timeout=30)


def run(out: Path, *options: str) -> tuple[int, dict]:
    """Exit code and result of the procedure on the emulated bench, driven from the topic."""
    words = ["run", str(PROCEDURE), "--controller", f"ros2:{TOPIC}", "--out", str(out), "--json", *options]
    done = subprocess.run([sys.executable, "-m", "hil", *words], stdout=subprocess.PIPE, text=True)
    return done.returncode, json.loads(done.stdout)


def test_it_ends_where_it_should_through_a_blind_camera(tmp_path: Path) -> None:
    """The estimate goes on by wheels and inertial unit meanwhile."""
    with controller():
        code, result = run(tmp_path, "--set", "bench.ros2.start_timeout_s=60", "--fault", "tracker:off@4+1")
    assert code == 0, result["error"]
    assert result["held"]["state"] == "HELD"
    (end,) = result["measurements"]
    assert end["value"] < 10.0


def test_without_its_controller_the_robot_is_held_and_the_run_says_why(tmp_path: Path) -> None:
    """A node that crashes as it starts must not pass."""
    code, result = run(tmp_path, "--set", "bench.ros2.start_timeout_s=2")
    assert code == 3
    assert result["held"]["state"] == "HELD"
    assert TOPIC in result["error"]["message"]
