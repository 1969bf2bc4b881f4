"""A whole procedure's recording repeats bit for bit: every stretch of it says how it began."""

import pytest
from procedure_runs import assert_verifies, run

import hil
from hil.controller.joint_script import JointScript, Stretch
from hil.core.errors import UsageError
from hil.procedure.scripted_joints import play
from hil.recording.mcap_writer import McapRecorder
from hil.replay.recordings import open_recording
from hil.replay.verification import verify_run

pytestmark = pytest.mark.timeout(600)  # the first process to start may compile the estimators


@pytest.mark.long
def test_the_recording_of_bring_up_verifies_from_end_to_end(tmp_path):
    """That of `latency` is looked at beside its figures."""
    run("bring_up", tmp_path / "bring_up", {"watch_s": 2.0})
    assert_verifies(tmp_path / "bring_up" / "recording.mcap")


def test_another_script_is_noticed(tmp_path):
    path = tmp_path / "jog.mcap"
    bench = hil.open_bench("emulated", seed=2)
    bench.add_sink(McapRecorder(path, bench.header(), lossless=True))
    script = [Stretch(0.1, (0.1, 0.0, 0.0, 0.0)), Stretch(0.1, steering_rad=(0.1, 0.0, 0.0, 0.0))]
    with bench:
        pose = bench.settle(0.1)
        motion = play(bench, script, pose, [0.0] * 4)
    assert motion.records[-1].setpoint.steering_rad[0] == pytest.approx(0.1, abs=0.02)
    opened = open_recording(path)
    scripted = opened.run(1)
    assert verify_run(opened.bench, scripted)["difference"] is None
    scripted.start.trajectory["stretches"][0]["rate_rad_s"][0] = 0.2
    assert "setpoint.wheel_rate_rad_s[0]" in verify_run(opened.bench, scripted)["difference"]


def test_a_script_survives_its_note_and_nonsense_is_refused():
    script = JointScript(
        [Stretch(0.3, steering_rad=[0.1, 0.2, 0.3, 1.0 / 3.0]), Stretch(0.2)], [0.0] * 3, [0.0] * 4
    )
    again = JointScript.from_mapping(script.to_mapping())
    for t_s in (0.0, 0.1, 0.3, 0.45, 9.0):
        first, second = script.setpoint(t_s), again.setpoint(t_s)
        assert first.steering_rad.tobytes() == second.steering_rad.tobytes()
        assert first.wheel_rate_rad_s.tobytes() == second.wheel_rate_rad_s.tobytes()
    with pytest.raises(UsageError, match="no script"):
        JointScript.from_mapping({"stretches": [{"size": 3}]})
    with pytest.raises(UsageError, match="script of"):
        JointScript([], [0.0] * 3, [0.0] * 4)
