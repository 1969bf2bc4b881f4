"""A program on ROS 2 drives the benches of a campaign and of the user's own tests."""

import contextlib
import io
import json

import pytest

from hil.cli import main
from tests.patience import patient_bench
from tests.ros2.test_joint_commands import MOVES, TIMES
from tests.ros2.test_lockstep import TOPIC, driver

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
pytest_plugins = ["pytester"]

FOLLOWS = {"on": "states", "stamp": "copy", "follow": 120}
TEST = """
import pytest
from hil.robot.trajectories import line

@pytest.mark.controller({controller!r}{domain})
@pytest.mark.parametrize("again", [0, 1])
def test_it_moves(bench, again):
    motion = bench.drive(line((0, 0, 0), (0.03, 0, 0)), start_pose=(0, 0, 0), hold_s=0.5, feedback="odometry")
    assert abs(motion.records[-1].state.pose_body_in_wall[0] - 0.03) < 0.005
"""


@pytest.mark.timeout(300)
def test_the_runs_of_a_campaign_are_driven_one_after_the_other(tmp_path, domain, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "moves.py").write_text(MOVES)
    bench = patient_bench(tmp_path, "emulated_floor", ros2=TIMES)
    words = ["campaign", "moves.py", "--seeds", "0:2", "--bench", str(bench), "--controller", f"ros2:{TOPIC}"]
    out = io.StringIO()
    with driver(domain, FOLLOWS), contextlib.redirect_stdout(out):
        code = main([*words, "--ros2-domain", str(domain), "--out", "results", "--json"])
    table = json.loads(out.getvalue())
    assert code == 0, table
    assert table["verdicts"] == {"PASS": 2}
    assert all(f"ros2:{TOPIC}" in row["command"] for row in table["rows"])


@pytest.mark.timeout(300)
def test_a_test_of_the_users_own_names_its_controller(tmp_path, domain, pytester):
    bench = patient_bench(tmp_path, "emulated_floor", ros2=TIMES)
    pytester.makepyfile(TEST.format(controller=f"ros2:{TOPIC}", domain=f", domain={domain}"))
    with driver(domain, FOLLOWS):
        result = pytester.runpytest_subprocess(f"--bench={bench}", "--emulate=all")
    result.assert_outcomes(passed=2)


@pytest.mark.parametrize(
    ("controller", "domain", "outcome"),
    [
        ("nonlinear", "", {"passed": 2}),
        ("nonsense", "", {"errors": 2}),
        (7, "", {"errors": 2}),
        ("ros2:joint commands", "", {"errors": 2}),
        (f"ros2:{TOPIC}", ", domain=102", {"errors": 2}),
    ],
)
def test_a_marker_is_a_law_too_and_a_wrong_one_an_error(controller, domain, outcome, tmp_path, pytester):
    bench = patient_bench(tmp_path, "emulated_floor")
    pytester.makepyfile(TEST.format(controller=controller, domain=domain))
    result = pytester.runpytest_subprocess(f"--bench={bench}", "--emulate=all")
    result.assert_outcomes(**outcome)
    result.stdout.no_fnmatch_line("*INTERNALERROR*")
