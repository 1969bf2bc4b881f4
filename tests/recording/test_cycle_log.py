"""A long drive keeps its cycles on the disk: what comes back, what stays in memory, what a disk refuses."""

import pickle
import tracemalloc
import weakref
from dataclasses import replace

import numpy as np
import pytest
from mcap_cases import driving_record

from hil.core.errors import UsageError
from hil.loop.driven_motion import Motion
from hil.recording.cycle_codec import CycleCodec
from hil.recording.cycle_log import CycleLog

COUNT = 2600
COLUMNS = [tracemalloc.Filter(True, "*/hil/loop/motion_columns.py")]
CODEC = CycleCodec()


@pytest.fixture(scope="module")
def records():
    return [driving_record(k) for k in range(COUNT)]


@pytest.fixture(scope="module")
def log(records):
    filled = CycleLog()
    for record in records:
        filled.append(record)
    return filled


def same(one, other):
    return CODEC.encode(one) == CODEC.encode(other)


def test_a_log_is_the_sequence_of_its_records(log, records):
    assert len(log) == COUNT
    assert sum(map(same, log, records)) == COUNT
    for index in (0, 1, 249, 250, 2399, COUNT - 1, -1, -COUNT):
        assert same(log[index], records[index])
    assert all(map(same, log[240:260], records[240:260]))
    assert same(log[::-1000][1], records[::-1000][1])
    with pytest.raises(IndexError):
        log[COUNT]
    assert all(map(same, pickle.loads(pickle.dumps(log))[:300], records[:300]))


def test_the_arrays_of_a_long_drive_are_those_of_its_records(log, records):
    long, whole = log.motion(), Motion(tuple(records))
    for name in ("t_s", "reference", "estimate", "twist", "covariance", "wheels", "mocap"):
        np.testing.assert_array_equal(getattr(long, name), getattr(whole, name), err_msg=name)
    np.testing.assert_array_equal(long.diagnostic("nis_wheels"), whole.diagnostic("nis_wheels"))
    assert set(long.columns.diagnostics) == set(whole.columns.diagnostics)
    for name, values in pickle.loads(pickle.dumps(long.columns)).diagnostics.items():
        np.testing.assert_array_equal(values, whole.diagnostic(name), err_msg=name)
    np.testing.assert_array_equal(long.covariance, [r.state.covariance for r in records])
    assert long.events == whole.events
    both = Motion(tuple(records[:10])).then(Motion(tuple(records[10:500])))
    np.testing.assert_array_equal(both.mocap, Motion(tuple(records[:500])).mocap)
    with pytest.raises(UsageError):
        long.observer("nobody")


def test_the_newest_cycles_alone_stay_in_memory(records):
    log, left = CycleLog(), []
    for record in records:
        log.append(replace(record, state=replace(record.state)))
        left.append(weakref.ref(log[-1].state))
    alive = [state() is not None for state in left]
    assert not any(alive[:250])
    assert all(alive[-2000:])


def test_cycles_that_no_disk_takes_stay_in_memory(records, tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("TMPDIR", str(tmp_path / "nowhere"))
    monkeypatch.setattr("tempfile.tempdir", None)
    log = CycleLog()
    for record in records:
        log.append(record)
    assert all(map(same, log, records))
    np.testing.assert_array_equal(log.motion().estimate, Motion(tuple(records)).estimate)
    (message,) = caplog.messages
    assert "nowhere" in message


def test_diagnostics_of_older_cycles_are_not_in_memory_and_some_cycles_have_none(records):
    """Half of what a long drive kept were its diagnostics, 57 on a wall."""
    names = [f"figure_{k}" for k in range(200)]
    log, expected = CycleLog(), []
    tracemalloc.start()
    for k, record in enumerate(records):
        value = float(k) if k % 1000 < 700 else np.nan
        figures = dict.fromkeys(names, value) if value == k else {}
        log.append(replace(record, state=replace(record.state, diagnostics=figures)))
        expected.append(value)
    del record, figures
    log.append(records[0])
    motion = log.motion()
    kept = sum(stat.size for stat in tracemalloc.take_snapshot().filter_traces(COLUMNS).statistics("lineno"))
    tracemalloc.stop()
    for name in (names[0], names[-1]):
        np.testing.assert_array_equal(motion.diagnostic(name)[:-1], expected)
    assert kept < 0.9 * 8 * len(names) * COUNT, "the newest 2000 of 2600 cycles are in memory"
