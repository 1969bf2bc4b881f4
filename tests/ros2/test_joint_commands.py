"""A program on ROS 2 drives in real time, at the wire: in `hil live`, and in a procedure of `hil run`."""

import contextlib
import io
import json
import re
import signal
import time

import numpy as np
import pytest

from hil.cli import main
from hil.recording.mcap_reader import read_cycles
from tests.patience import patient_bench
from tests.ros2.test_lockstep import TOPIC, driver

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")

pytestmark = pytest.mark.usefixtures("warm_commands")
PATIENCE_S = 240
ROLLS = {"on": 50, "stamp": "wall", "velocity": [0.5] * 4}
TIMES = {"late_after_s": 1.0, "start_timeout_s": 60.0, "answer_timeout_s": 20.0}
MOVES = """
from hil.procedure import Context, Measurement, procedure
from hil.robot.trajectories import line

@procedure(name="moves", needs=("servos",), measurements=[Measurement("end_m", "m")])
def run(ctx: Context) -> None:
    \"\"\"Follows a line.\"\"\"
    pose = ctx.bench.settle()
    end = (pose[0] + 0.03, pose[1], pose[2])
    motion = ctx.bench.drive(line(pose, end), hold_s=0.5)
    ctx.measure("end_m", float(motion.records[-1].state.pose_body_in_wall[0] - pose[0]))
"""


def ended(running):
    out, err = running.communicate(timeout=PATIENCE_S)
    return running.returncode, json.loads(out), err


def verdict(path):
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        main(["replay", str(path), "--verify", "--json"])
    return json.loads(out.getvalue())["verdict"]


@pytest.mark.alone
@pytest.mark.timeout(PATIENCE_S + 60)
def test_joint_commands_drive_a_live_session_and_not_before_they_come(tmp_path, domain, live, listen):
    listener = listen("/joint_states")
    running = live(TOPIC, ros2=TIMES)
    listener.matched()
    listener.has_heard()
    with driver(domain, {**ROLLS, "after": 200, "then": {"velocity": [0.0] * 4}}):
        time.sleep(6.0)
        running.send_signal(signal.SIGTERM)
        code, answer, err = ended(running)
    assert code == 4, err
    assert answer["held"]["state"] in ("HELD", "not needed")
    assert answer["commands"]["cycles"] > 50
    cycles = list(read_cycles(tmp_path / "r.mcap"))
    rates = np.array([c.setpoint.wheel_rate_rad_s for c in cycles])
    first = next(k for k, c in enumerate(cycles) if c.external is not None and c.external.commands)
    assert not rates[:first].any()
    assert rates.max() == 0.5
    assert (rates >= 0.0).all()
    assert cycles[-1].state.pose_body_in_wall[0] - cycles[first].state.pose_body_in_wall[0] > 0.01
    assert verdict(tmp_path / "r.mcap") == "identical"


@pytest.mark.alone
@pytest.mark.timeout(PATIENCE_S + 60)
@pytest.mark.parametrize(
    ("settings", "answer"),
    [
        ({"on": "states", "limit": 500}, r"no command for .*process {pid} .*killed counts for up to 10 s"),
        ({"after": 40, "then": {"velocity": [0.5, 0.5, 0.5, 57.3]}}, "rpm"),
    ],
)
def test_a_program_that_is_killed_or_wrong_stops_a_live_session(settings, answer, tmp_path, domain, live):
    running = live(TOPIC, "--duration", "60", ros2=TIMES)
    with driver(domain, {**ROLLS, **settings}) as program:
        code, summary, err = ended(running)
    assert code == 3, err
    assert re.search(answer.format(pid=program.pid), summary["ended"])
    assert summary["held"]["state"] in ("HELD", "not needed")
    last = list(read_cycles(tmp_path / "r.mcap"))[-1]
    assert not last.command.drive_velocity_rad_s.any()
    assert verdict(tmp_path / "r.mcap") == "identical"


@pytest.mark.real_time
@pytest.mark.timeout(PATIENCE_S + 60)
def test_a_procedure_is_driven_by_a_program(tmp_path, domain, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "moves.py").write_text(MOVES)
    bench = patient_bench(tmp_path, "emulated_floor", ros2=TIMES)
    words = ["run", "moves.py", "--bench", str(bench), "--controller", f"ros2:{TOPIC}", "--realtime"]
    out = io.StringIO()
    with driver(domain, {"on": "states", "follow": 120}), contextlib.redirect_stdout(out):
        code = main([*words, "--ros2-domain", str(domain), "--out", "results", "--json"])
    result = json.loads(out.getvalue())
    assert code == 0, result["error"]
    measured = {row["name"]: row["value"] for row in result["measurements"]}
    assert abs(measured["end_m"] - 0.03) < 0.005
    assert result["held"]["state"] in ("HELD", "not needed")
    assert verdict("results/recording.mcap") == "identical"
