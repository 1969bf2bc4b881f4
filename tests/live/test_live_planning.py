"""What `hil live --trajectory` checks before it opens anything, and what is left to check afterwards."""

import numpy as np
import pytest

from hil.cli import live
from hil.core.errors import ConfigError
from hil.live import load_trajectory
from hil.robot.trajectories import through

POINTS = [(0.2, 0.1, 0.0), (0.4, 0.1, 0.0), (0.4, 0.3, 0.1)]


def waypoints(folder, points):
    path = folder / "way.csv"
    path.write_text("x,y,theta\n" + "".join(f"{x},{y},{theta}\n" for x, y, theta in points))
    return path


@pytest.mark.parametrize(("pose", "first"), [((0.0, 0.0, 0.0), 0), ((0.201, 0.101, 0.002), 1)])
def test_the_way_from_here_is_that_through_the_waypoints(tmp_path, pose, first):
    checked = []
    make, known = load_trajectory(waypoints(tmp_path, POINTS), checked.append)
    assert checked == [known]
    made = make(np.array(pose))
    assert made == through([pose, *POINTS[first:]], name="way")
    assert all(a is b for a, b in zip(made.segments[1:], known.segments[first:], strict=True))


def test_a_script_may_hold_a_dataclass_under_annotations_from_the_future(tmp_path):
    """`dataclasses` looks for the module by its name: where it is not found, the script had failed."""
    script = tmp_path / "way.py"
    script.write_text(
        "from __future__ import annotations\n"
        "from dataclasses import dataclass\n"
        "from hil.robot.trajectories import Trajectory, line\n\n\n"
        "@dataclass\nclass Way:\n    length_m: float = 0.1\n\n\n"
        "def trajectory(pose) -> Trajectory:\n"
        "    return line(pose, pose + [Way().length_m, 0.0, 0.0])\n"
    )
    make, _ = load_trajectory(script, lambda trajectory: None)
    assert make(np.zeros(3)).sample(1e3).pose_in_wall.tolist() == pytest.approx([0.1, 0.0, 0.0])


def test_a_script_that_is_no_python_is_named_with_its_line(tmp_path):
    script = tmp_path / "way.py"
    script.write_text("x = 1\ndef trajectory(\n")
    with pytest.raises(ConfigError, match=r"way\.py: line 2: "):
        load_trajectory(script, lambda trajectory: None)


@pytest.mark.parametrize(
    ("duration_s", "parts"), [(None, ["2 s"]), (3.0, ["3 s", "before"]), (20.0, ["waits"])]
)
def test_how_a_session_ends_is_said_as_the_drive_begins(tmp_path, capsys, duration_s, parts):
    make, _ = load_trajectory(waypoints(tmp_path, POINTS), lambda trajectory: None)
    made = live._announced(make, duration_s)(np.zeros(3))
    assert made == make(np.zeros(3))
    said = capsys.readouterr().err
    for part in (f"{made.duration_s:.1f} s", *parts):
        assert part in said
