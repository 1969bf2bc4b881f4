"""Every run says in its result, its recording and its page whether it left the robot held."""

import json

import pytest

from hil.procedure import Measurement, procedure
from hil.procedure.bench_source import BenchSource
from hil.procedure.runner import RunOptions, run_procedure
from hil.recording.mcap_reader import RecordingReader
from hil.report.run_page import write_run_page
from hil.robot.trajectories import line
from hil.vocabulary.clock import MonotonicClock


@procedure(name="climb", needs=("servos",), measurements=(Measurement("last", "1"),))
def climb(ctx):
    """Ten centimetres up."""
    ctx.bench.drive(line((0, 0, 0), (0.1, 0, 0), duration_s=3.0))
    ctx.bench.clock.sleep_until_ns(ctx.bench.clock.now_ns() + 2_000_000_000)
    ctx.measure("last", 1.0)


@pytest.mark.parametrize(
    ("faults", "state", "verdict", "said"),
    [
        ((), "HELD", "PASS", "at rest by"),
        (("servos:brownout@7+0.3",), "HELD", "PASS", "at rest by"),
        (("servos:off@7",), "NOT HELD", "ERROR", "no servo answers"),
        (("servos:off@2",), "NOT HELD", "ERROR", "no servo answers"),
        (("servo.steer_FR:off@7",), "NOT HELD", "ERROR", "steer_FR (ID 8"),
    ],
)
def test_a_result_says_whether_the_robot_is_held(tmp_path, faults, state, verdict, said):
    source = BenchSource("emulated", seed=1, faults=faults, overrides={"exit.look_after_s": 0.5})
    result = run_procedure(climb, source, RunOptions(tmp_path / "run", MonotonicClock(), "now", {}))
    tree = json.loads((result.folder / "result.json").read_text())
    assert (tree["held"]["state"], tree["verdict"]) == (state, verdict)
    assert said in tree["held"]["why"]
    assert result.exit_code == (0 if verdict == "PASS" else 3)
    assert (tree["held"]["moved_m"] > 0.003) == any(fault.startswith("servos:") for fault in faults)
    assert state in write_run_page(tmp_path / "run").read_text()
    (note,) = (
        n
        for n in RecordingReader(tmp_path / "run" / "recording.mcap").items()
        if getattr(n, "kind", "") == "held"
    )
    assert note.data == tree["held"]


def test_a_robot_on_the_floor_needs_nobody(tmp_path):
    source = BenchSource("emulated_floor", seed=1, faults=("servos:off@7",))
    result = run_procedure(climb, source, RunOptions(tmp_path / "run", MonotonicClock(), "now", {}))
    assert json.loads((result.folder / "result.json").read_text())["held"]["state"] == "not needed"
    assert result.exit_code == 0
