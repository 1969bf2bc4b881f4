"""A recording of version 0.1.0, without frames, encoders and clock offset, goes on being read."""

from pathlib import Path

import numpy as np

from hil.recording.export import tabulate
from hil.recording.mcap_reader import read_cycles, read_header, read_wall_offsets
from hil.replay.recordings import open_recording
from hil.replay.verification import rebuild, verify_recording

RECORDING = Path(__file__).with_name("data") / "recorded_by_0_1_0.mcap"


def test_every_cycle_is_read():
    records = list(read_cycles(RECORDING))
    assert [r.cycle for r in records] == [*range(21), *range(36)]
    assert read_header(RECORDING)["versions"]["hil"] == "0.1.0"
    assert read_wall_offsets(RECORDING) == ()
    assert np.isfinite(tabulate(records)[:, :9]).all()


def repeated(path, number=0):
    """Records of a run by odometry, each with what odometry makes of its inputs today."""
    opened = open_recording(path)
    run = opened.runs[number]
    brain = rebuild(opened.bench, run.start)
    brain.reset(run.start.state)
    return [(record, brain.decide(record.inputs)) for record in run.records]


def test_what_was_observed_repeats_bit_for_bit():
    """Run 0: odometry, nothing commanded. What it says of its certainty has become more since."""
    cycles = repeated(RECORDING)
    assert len(cycles) == 21
    for record, again in cycles:
        assert again.state.pose_body_in_wall.tobytes() == record.state.pose_body_in_wall.tobytes()
        assert again.state.twist_body.tobytes() == record.state.twist_body.tobytes()
        assert (again.state.covariance.diagonal() >= record.state.covariance.diagonal()).all()
    (told,) = verify_recording(open_recording(RECORDING), 0)
    assert "state.covariance" in told["difference"]


def test_observers_that_were_kept_among_the_diagnostics_repeat():
    path = RECORDING.with_name("observers_among_diagnostics.mcap")
    (first, *_) = read_cycles(path)
    assert first.observers == {}
    assert np.isfinite(first.state.diagnostics["odometry_x_m"])
    cycles = repeated(path)
    assert len(cycles) == 15
    for record, again in cycles:
        kept = [record.state.diagnostics[f"odometry_{name}"] for name in ("x_m", "y_m", "theta_rad")]
        assert again.observers["odometry"].pose_body_in_wall.tolist() == kept
