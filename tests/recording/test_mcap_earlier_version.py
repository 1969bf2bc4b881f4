"""A recording of version 0.1.0, without frames, encoders and clock offset, goes on being read."""

from pathlib import Path

import numpy as np

from hil.recording.export import tabulate
from hil.recording.mcap_reader import read_cycles, read_header, read_wall_offsets
from hil.replay.recordings import open_recording
from hil.replay.verification import verify_recording

RECORDING = Path(__file__).with_name("data") / "recorded_by_0_1_0.mcap"


def test_every_cycle_is_read():
    records = list(read_cycles(RECORDING))
    assert [r.cycle for r in records] == [*range(21), *range(36)]
    assert read_header(RECORDING)["versions"]["hil"] == "0.1.0"
    assert read_wall_offsets(RECORDING) == ()
    assert np.isfinite(tabulate(records)[:, :9]).all()


def test_what_was_observed_repeats_bit_for_bit():
    """Run 0: odometry, nothing commanded. Filters and control laws may improve and then decide otherwise."""
    (told,) = verify_recording(open_recording(RECORDING), 0)
    assert (told["cycles"], told["difference"]) == (21, None)


def test_observers_that_were_kept_among_the_diagnostics_repeat():
    path = RECORDING.with_name("observers_among_diagnostics.mcap")
    (first, *_) = read_cycles(path)
    assert first.observers == {}
    assert np.isfinite(first.state.diagnostics["odometry_x_m"])
    (told,) = verify_recording(open_recording(path))
    assert (told["cycles"], told["difference"]) == (15, None)
