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
pytestmark = pytest.mark.usefixtures("warm_commands")

FOLLOWS = {"on": "states", "stamp": "copy", "follow": 120}
TESTS = """
import pytest
from hil.robot.trajectories import line

def moves(bench):
    motion = bench.drive(line((0, 0, 0), (0.03, 0, 0)), start_pose=(0, 0, 0), hold_s=0.5, feedback="odometry")
    assert abs(motion.records[-1].state.pose_body_in_wall[0] - 0.03) < 0.005

@pytest.mark.controller("ros2:TOPIC", domain=DOMAIN)
@pytest.mark.parametrize("again", [0, 1])
def test_by_a_program(bench, again):
    moves(bench)

@pytest.mark.controller("nonlinear")
def test_by_a_law(bench):
    moves(bench)

@pytest.mark.controller("nonsense")
def test_unknown(bench):
    moves(bench)

@pytest.mark.controller(7)
def test_no_name(bench):
    moves(bench)

@pytest.mark.controller("ros2:joint commands")
def test_no_topic(bench):
    moves(bench)

@pytest.mark.controller("ros2:TOPIC", domain=102)
def test_no_domain(bench):
    moves(bench)
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
def test_a_test_of_the_users_own_names_its_controller_and_a_wrong_one_is_an_error(tmp_path, domain, pytester):
    bench = patient_bench(tmp_path, "emulated_floor", ros2=TIMES)
    pytester.makepyfile(TESTS.replace("TOPIC", TOPIC).replace("DOMAIN", str(domain)))
    with driver(domain, FOLLOWS):
        result = pytester.runpytest_subprocess(f"--bench={bench}", "--emulate=all")
    result.assert_outcomes(passed=3, errors=4)
    result.stdout.no_fnmatch_line("*INTERNALERROR*")
