"""What `hil live --trajectory` checks before it opens anything, and what is left to check afterwards."""

import numpy as np
import pytest
import tomli_w

from hil.bench import plan_bench
from hil.cli import main
from hil.config import loading
from hil.live import load_trajectory
from hil.robot.kinematics import WheelGeometry
from hil.robot.motion_limits import MotionLimits, check
from hil.robot.trajectories import Trajectory, line, through
from hil.vocabulary.errors import ConfigError, TrajectoryError

CAD = WheelGeometry.nominal().projection()
POINTS = [(0.2, 0.1, 0.0), (0.4, 0.1, 0.0), (0.4, 0.3, 0.1)]
TOO_QUICK = line((0.2, 0.0, 0.0), (0.7, 0.0, 0.0), duration_s=1.0).segments
SLOW = line((0.0, 0.0, 0.0), (0.2, 0.0, 0.0)).segments


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


def test_what_is_known_to_hold_is_not_looked_at_again_and_all_else_is():
    known, limits = Trajectory("known", TOO_QUICK), MotionLimits()
    check(Trajectory("new", SLOW + TOO_QUICK), CAD, limits, known=known)
    alike = line((0.2, 0.0, 0.0), (0.7, 0.0, 0.0), duration_s=1.0).segments
    late = MotionLimits(x_range_m=(0.0, 0.1))
    for trajectory, found in (
        (Trajectory("alike, not the same", SLOW + alike), limits),
        (Trajectory("known comes first", TOO_QUICK + SLOW), limits),
        (Trajectory("known comes twice", TOO_QUICK + TOO_QUICK), limits),
        (Trajectory("too far before it is known", SLOW + TOO_QUICK), late),
    ):
        with pytest.raises(TrajectoryError):
            check(trajectory, CAD, found, known=known)


def test_a_motion_that_is_too_long_is_refused_whatever_of_it_is_known():
    hour = line((0.0, 0.0, 0.0), (0.2, 0.0, 0.0), duration_s=3700.0)
    back = line((0.2, 0.0, 0.0), (0.0, 0.0, 0.0), duration_s=3700.0)
    with pytest.raises(TrajectoryError, match="divide the motion"):
        check(Trajectory("two hours", hour.segments + back.segments), CAD, MotionLimits(), known=back)


def test_the_bench_file_is_read_once(tmp_path, monkeypatch, capsys):
    """A way that leaves the wall is refused when it is planned, by the limits of the file."""
    bench = plan_bench("emulated").config
    tree = bench.model_dump(mode="json", by_alias=True, exclude_none=True)
    tree["environment"]["x_range_m"] = [-0.1, 0.3]
    (tmp_path / "bench.toml").write_bytes(tomli_w.dumps(tree).encode())
    found, read = [], loading.find_bench
    monkeypatch.setattr(loading, "find_bench", lambda source: found.append(source) or read(source))
    given = ["--bench", str(tmp_path / "bench.toml"), "--trajectory", str(waypoints(tmp_path, POINTS))]
    assert main(["live", *given, "--no-record"]) == 2
    assert "x on the wall" in capsys.readouterr().err
    assert found == [str(tmp_path / "bench.toml")]
