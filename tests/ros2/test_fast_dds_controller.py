"""The controller of `examples/ros2`, on Fast DDS in a process of its own, drives the emulated robot."""

import contextlib
import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hil.recording.mcap_reader import read_cycles
from tests.patience import patient_bench

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")

PATIENCE_S = 600
pytestmark = [pytest.mark.long, pytest.mark.real_time, pytest.mark.timeout(2 * PATIENCE_S)]
UP_M = 0.06
BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "ros2_round_trip.py"
FOLLOWS = f"""
import numpy as np
from hil.procedure import Context, Measurement, procedure
from hil.procedure.tracking_errors import enable_hold
from hil.robot.trajectories import line

@procedure(
    name="follows",
    needs=("servos", "mocap"),
    measurements=[Measurement("end_error", "mm", high=5.0, rationale="a tenth of the way")],
)
def run(ctx: Context) -> None:
    \"\"\"Another program drives up; motion capture says where it got to.\"\"\"
    start = enable_hold(ctx.bench)
    goal = start + np.array([{UP_M}, 0, 0])
    motion = ctx.bench.drive(line(start, goal, duration_s=3.0), hold_s=1.0)
    ctx.measure("end_error", 1e3 * np.hypot(*(motion.mocap[-1] - goal)[:2]))
"""


@pytest.fixture
def program(wall_line_dds, domain):
    """Begins the controller; it is ended with the test."""
    begun = []

    def begin(*options):
        words = [str(wall_line_dds), "--domain", str(domain), "--up", str(UP_M), *options]
        begun.append(subprocess.Popen(words, stdout=subprocess.PIPE, text=True))
        assert begun[-1].stdout.readline() == "ready\n"
        return begun[-1]

    yield begin
    for one in begun:
        with contextlib.suppress(ProcessLookupError):
            one.send_signal(signal.SIGCONT)
        one.kill()
        one.wait()
        one.stdout.close()


def hil(folder, *words):
    command = [sys.executable, "-m", "hil", *map(str, words), "--json"]
    return subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=folder)


@pytest.mark.parametrize(("commands", "topic"), [("joints", "/joint_commands"), ("twist", "/cmd_vel")])
def test_in_real_time_the_robot_follows(commands, topic, tmp_path, domain, program):
    controller = program("--commands", commands)
    bench = patient_bench(tmp_path, "emulated", ros2={"late_after_s": 2.0, "start_timeout_s": 60.0})
    options = ("--controller", f"ros2:{topic}", "--ros2-domain", domain, "--record", "r.mcap")
    live = hil(tmp_path, "live", "--bench", bench, *options)
    try:
        assert [controller.stdout.readline() for _ in range(2)] == ["begun\n", "done\n"]
        live.send_signal(signal.SIGTERM)
        out, err = live.communicate(timeout=PATIENCE_S)
    finally:
        live.kill()
    assert live.returncode == 4, err
    assert json.loads(out)["held"]["state"] == "HELD"
    cycles = [c for c in read_cycles(tmp_path / "r.mcap") if c.inputs.mocap]
    seen = np.array([c.inputs.mocap[-1].position_m for c in cycles])
    assert (seen[-1] - seen[0])[0] == pytest.approx(UP_M, abs=0.01)


def lockstep(folder, domain, out):
    (folder / "follows.py").write_text(FOLLOWS)
    words = ("run", "follows.py", "--controller", "ros2:/joint_commands", "--ros2-domain", domain)
    words += ("--out", out)
    return hil(folder, *words)


def ended(run):
    try:
        out, err = run.communicate(timeout=PATIENCE_S)
    finally:
        run.kill()
    return run.returncode, json.loads(out), err


def recorded(folder):
    (path,) = folder.rglob("*.mcap")
    return [c for c in read_cycles(path) if c.reference is not None]


def test_in_lockstep_the_robot_follows_and_a_run_repeats_itself(tmp_path, domain, program):
    runs = []
    for out in ("first", "second"):
        controller = program()
        code, answer, err = ended(lockstep(tmp_path, domain, out))
        assert code == 0, err
        assert answer["held"]["state"] == "HELD"
        assert "synchronised" not in err
        controller.kill()
        controller.wait()
        runs.append(recorded(tmp_path / out))
    first, second = ([(c.state.pose_body_in_wall, c.setpoint.wheel_rate_rad_s) for c in run] for run in runs)
    assert len(first) == len(second) > 300
    np.testing.assert_array_equal(
        np.hstack([np.hstack(c) for c in first]), np.hstack([np.hstack(c) for c in second])
    )


def test_the_benchmark_finds_answers_in_real_time_and_in_lockstep(wall_line_dds, domain):
    words = ["--seconds", "1", "--runs", "1", "--domain", str(domain), "--program", str(wall_line_dds)]
    done = subprocess.run(
        [sys.executable, str(BENCHMARK), *words], capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    for rate in ("100_hz", "500_hz"):
        assert 0.0 < answer[rate]["answered_in_time_percent"] <= 100.0
        assert 0.0 < answer[rate]["round_trip_ms"]["median"] <= answer[rate]["round_trip_ms"]["p99"]
    assert answer["lockstep"]["controller_hz"] > 0.0
