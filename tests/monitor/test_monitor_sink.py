"""The Rerun sink: what it sends, what a dead or stalled viewer costs, and what it says without Rerun."""

from __future__ import annotations

import importlib.util
import math
import resource
import signal
import socket
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.core.errors import DataError, UsageError
from hil.core.signals import (
    SERVOS,
    CycleRecord,
    Event,
    Inputs,
    Measurements,
    MocapSample,
    PoseMeasurement,
    Reference,
    RobotState,
    ServoHealth,
    ServoSample,
    ServoSetpoint,
    Stamp,
    Status,
    WheelMeasurement,
    WheelSetpoint,
)
from hil.monitor import RerunMonitor
from hil.monitor.plot_series import Series, SeriesCollector
from hil.monitor.record_pipe import put
from hil.monitor.rerun_layout import line_colours
from hil.monitor.rrd_file import what_is_missing
from hil.monitor.sink import split_targets

needs_rerun = pytest.mark.skipif(
    importlib.util.find_spec("rerun") is None, reason="the extra `rerun` is not installed"
)


def shown(k: int) -> CycleRecord:
    t_ns = k * 10_000_000
    stamp = Stamp(t_ns, t_ns, k)
    pose = np.array([0.0005 * k, 0.0, 0.01])
    ok = (Status.OK,) * 8
    return CycleRecord(
        k,
        t_ns,
        t_ns,
        Inputs(
            k,
            t_ns,
            servos=(ServoSample(stamp, np.arange(8.0), np.ones(8), np.zeros(8), ok),),
            health=(ServoHealth(stamp, np.full(8, 12.0), np.full(8, 41.0), ok),) if k % 50 == 0 else (),
            mocap=(MocapSample(stamp, pose, np.array([1.0, 0, 0, 0]), True, 0.004, 1e-4),) if k % 2 else (),
        ),
        Measurements(
            k,
            t_ns,
            (WheelMeasurement(stamp, np.zeros(4), np.ones(4), np.zeros(4), (True,) * 4),),
            mocap=(PoseMeasurement(stamp, "mocap", pose, 3, True),),
        ),
        RobotState(t_ns, pose, np.zeros(3), np.eye(6) * 1e-4, {"nis_wheels": 2.0}),
        Reference(t_ns / 1e9, pose + np.array([0.01, 0.0, 0.0]), np.zeros(3), np.zeros(3)),
        WheelSetpoint(np.zeros(4), np.zeros(4)),
        ServoSetpoint(np.zeros(4), np.zeros(4)),
        (Event(t_ns, "error", "imu", "stale"),) if k == 7 else (),
        timing_ns={"read": 500_000, "decide": 250_000},
    )


def column(series: Series, name: str) -> np.ndarray:
    return series.values[:, series.names.index(name)]


def test_series_carry_every_cycle_once_with_its_time():
    collector = SeriesCollector()
    for k in range(10, 20):
        collector.add(shown(k))
    taken = dict(collector.take())
    positions = taken["servos/position_rad"]
    assert positions.names == SERVOS
    np.testing.assert_allclose(positions.t_s, np.arange(10) * 0.01)
    assert positions.cycles == list(range(10, 20))
    assert column(taken["loop"], "decide").tolist() == [0.25] * 10
    assert column(taken["innovations/normalised"], "nis_wheels")[3] == 2.0
    assert column(taken["ages"], "mocap")[1:].tolist() == [0.0, 10.0] * 4 + [0.0]
    np.testing.assert_allclose(taken["state/tracking_error_m"].values[0], [0.01, 0.0])
    assert "estimator/states" not in taken
    assert collector.take() == []


def test_a_figure_that_comes_later_gets_a_column_and_nothing_before():
    """Nothing that waits to be shown is lost when a cycle brings figures that others lack."""
    collector = SeriesCollector()
    for k in range(3):
        state = replace(shown(k).state, diagnostics={"nis_gyro": 0.5} if k == 2 else {"nis_wheels": 0.1})
        collector.add(replace(shown(k), state=state))
    found = dict(collector.take())["innovations/normalised"]
    assert found.names == ("nis_wheels", "nis_gyro")
    np.testing.assert_array_equal(found.values, [[0.1, np.nan], [0.1, np.nan], [np.nan, 0.5]])


def test_columns_of_an_entity_never_change_and_what_comes_later_stands_below_it():
    """Rerun draws as many lines of an entity as its first piece has columns."""
    collector, seen = SeriesCollector(), []
    for k, diagnostics in enumerate(
        [{"nis_wheels": 0.1}, {"nis_wheels": 0.2, "nis_gyro": 0.5}, {"nis_gyro": 0.7}]
    ):
        collector.add(replace(shown(k), state=replace(shown(k).state, diagnostics=diagnostics)))
        seen.append(dict(collector.take()))
    entity, later = "innovations/normalised", "innovations/normalised/later_1"
    assert [s[entity].names for s in seen] == [("nis_wheels",)] * 3
    assert later not in seen[0]
    assert [s[later].names for s in seen[1:]] == [("nis_gyro",)] * 2
    assert [float(s[later].values[0, 0]) for s in seen[1:]] == [0.5, 0.7]
    assert seen[2][later].before == 1
    assert line_colours(("a",), 1) == line_colours(("b", "a"))[1:]


def beside(k: int, sigma_m: float = 0.01) -> CycleRecord:
    """With an unscented filter beside the loop."""
    record = shown(k)
    ukf = RobotState(
        record.state.t_ns,
        np.array([0.3 + 0.01 * k, 0.4, 0.0]),
        np.zeros(3),
        np.diag([sigma_m**2, 4e-4, 0, 0, 0, 0]),
    )
    odometry = replace(ukf, pose_body_in_wall=np.array([0.1 + 0.01 * k, 0.2, 0.0]))
    return replace(record, observers={"ukf": ukf, "odometry": odometry})


def test_counters_and_slow_states_are_thinned_out():
    collector = SeriesCollector()
    for k in range(100):
        record = shown(k)
        reported = {"nis_wheels": 2.0, "rejected_gyro": float(k), "sag_m_s": 0.001}
        collector.add(replace(record, state=replace(record.state, diagnostics=reported)))
    taken = dict(collector.take())
    assert len(taken["innovations/normalised"].t_s) == 100
    assert len(taken["estimator/states"].t_s) == 10
    np.testing.assert_array_equal(taken["estimator/rejected"].values[:, 0], np.arange(0.0, 100.0, 10.0))


@pytest.mark.parametrize("target", ["", " , "])
def test_empty_targets_are_refused(target):
    with pytest.raises(UsageError, match="spawn, connect, serve"):
        split_targets(target)


@needs_rerun
@pytest.mark.parametrize(
    ("target", "meant"),
    [
        ("http://127.0.0.1:1/proxy", "rerun+http://127.0.0.1:1/proxy"),
        ("spawn,ftp://robot/x.rrd", "rerun+http://robot/proxy"),
        ("rerun://robot:99999/proxy", "rerun://robot:99999/proxy"),
        ("rerun+http://", "rerun+http://127.0.0.1:9876/proxy"),
    ],
)
def test_an_address_that_is_none_of_reruns_is_refused(tmp_path, monkeypatch, target, meant):
    """Files had gone into a folder `http:`, or the monitor's process had ended with a traceback."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError) as refused:
        split_targets(target)
    word = target.rpartition(",")[2]
    assert str(refused.value).startswith(f"the monitor cannot open {word!r}; expected a URL as rerun+http://")
    assert str(refused.value).endswith(f"did you mean {meant}?")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("target", ["taken.rrd", "serve,taken.rrd", "/proc/view.rrd"])
def test_a_file_that_cannot_be_written_is_refused_beforehand(tmp_path, monkeypatch, target):
    """Rerun's own error had come as a traceback, after the estimators had run."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken.rrd").mkdir()
    with pytest.raises(DataError, match=r"taken.rrd: is a folder|view.rrd: cannot be written"):
        split_targets(target)


def test_without_rerun_the_extra_is_named(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UsageError, match=r"install .*rerun-sdk"):
        RerunMonitor("spawn", lossless=True)


@needs_rerun
def test_virtual_time_writes_every_cycle_to_a_file_whose_folder_is_made(tmp_path):
    """However slow the viewer is. Every filter has its ellipse, once it knows how sure it is."""
    path = tmp_path / "new" / "folder" / "run.rrd"
    monitor = RerunMonitor(str(path), lossless=True, capacity=20)
    monitor._process.send_signal(signal.SIGSTOP)
    resumed = threading.Timer(0.5, monitor._process.send_signal, (signal.SIGCONT,))
    resumed.start()
    for k in range(100):
        monitor.write(beside(k, math.nan if k < 5 else 0.01))
    monitor.close()
    monitor.close()
    assert (monitor.dropped, monitor.failure) == (0, "")
    data = path.read_bytes()
    assert data[:3] == b"RRF"
    for entity in (b"servos/position_rad", b"robot/covariance_95", b"path/truth", b"innovations/normalised"):
        assert entity in data
    assert b"path/ukf" in data
    assert b"path/odometry" in data
    assert b"ukf/covariance_95" in data
    assert b"odometry/covariance_95" not in data
    cut, oracle = tmp_path / "cut.rrd", Path(sys.executable).with_name("rerun")
    cut.write_bytes(data[: len(data) // 2])
    for file in (path, cut):
        said = subprocess.run([str(oracle), "rrd", "verify", str(file)], capture_output=True, check=False)
        assert bool(what_is_missing(file)) is bool(said.returncode) is (file == cut)


@needs_rerun
def test_real_time_shows_the_same_through_its_own_process(tmp_path):
    first, second = tmp_path / "a.rrd", tmp_path / "b.rrd"
    monitor = RerunMonitor(f"{first},{second}", lossless=False)
    for k in range(100):
        monitor.write(shown(k))
    monitor.close()
    assert (monitor.dropped, monitor.failure) == (0, "")
    for path in (first, second):
        assert b"robot/speeds" in path.read_bytes()


@needs_rerun
def test_a_file_that_the_disk_did_not_take_is_named_as_incomplete(tmp_path, capfd):
    """With a file of Rerun's own the process had waited for ever, or not, as the threads ran."""
    path = tmp_path / "full.rrd"
    monitor = RerunMonitor(str(path), lossless=False)
    resource.prlimit(monitor._process.pid, resource.RLIMIT_FSIZE, (20_000, 20_000))  # or what is there by now
    for k in range(100):
        monitor.write(shown(k))
    monitor.close()
    broken_off = f"{path.stat().st_size / 1e6:.1f} MB"
    assert monitor.failure == f"{path} is incomplete: it breaks off after {broken_off}"
    assert f"{path}: cannot be written (File too large)" in capfd.readouterr().err


@needs_rerun
def test_a_viewer_that_does_not_answer_costs_drops_and_nothing_else():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        monitor = RerunMonitor(
            f"rerun+http://127.0.0.1:{port}/proxy", lossless=False, capacity=20, patience_s=1.0
        )
        for k in range(2000):
            monitor.write(shown(k))
        assert monitor.dropped > 0
        assert len(monitor._waiting) <= 20
        monitor.close()


@needs_rerun
def test_a_viewer_that_is_not_there_is_no_silent_end(tmp_path, caplog, capfd):
    """It had ended with nothing shown and nothing said; a file beside is whole all the same."""
    path = tmp_path / "run.rrd"
    monitor = RerunMonitor(f"rerun+http://127.0.0.1:1/proxy,{path}", lossless=True)
    for k in range(50):
        monitor.write(shown(k))
    monitor.close()
    assert monitor.failure == "the viewer at rerun+http://127.0.0.1:1/proxy did not take everything"
    assert caplog.messages == [f"monitor: {monitor.failure}"]
    assert what_is_missing(path) == ""
    assert "hil monitor: a viewer did not take everything (" in capfd.readouterr().err


@needs_rerun
def test_the_monitors_process_ends_quietly_where_its_parent_went_while_it_started():
    with subprocess.Popen(
        [sys.executable, "-m", "hil.monitor", "spawn"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        process.stdout.close()
        put(process.stdin, b"scene")
        process.stdin.close()
        assert process.stderr.read() == b""
    assert process.returncode == 0


@needs_rerun
def test_a_killed_monitor_is_named_and_the_rest_counted():
    monitor = RerunMonitor("rerun+http://127.0.0.1:1/proxy", lossless=False, capacity=10)
    monitor._process.kill()
    monitor._process.wait()
    for k in range(500):
        monitor.write(shown(k))
    monitor.close()
    assert "has ended" in monitor.failure
    assert monitor.dropped > 400


ORPHAN = """
import os, threading
import hil.monitor.__main__ as own
own._LOOK_S = own._LEFT_S = 0.1
threading.Thread(target=own._outlive_not, args=(int({parent}),), daemon=True).start()
os.write(1, b"waits")
threading.Event().wait()
"""


def test_the_monitors_process_does_not_wait_for_ever_once_its_parent_is_gone():
    inner = ORPHAN.format(parent="os.environ['PARENT']")
    outer = (
        "import os, subprocess, sys\nos.environ['PARENT'] = str(os.getpid())\n"
        f"subprocess.Popen([sys.executable, '-c', {inner!r}])\nsys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", outer], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as parent:
        assert parent.stdout.read(5) == b"waits"
        parent.stdin.close()
        assert parent.stdout.read() == b""  # the end: no process holds it open
