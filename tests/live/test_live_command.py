"""`hil live` from the outside: what it prints, what it leaves behind, how it ends."""

import contextlib
import io
import json
import os
import re
import resource
import signal
import socket
import subprocess
import sys

import numpy as np
import pytest
import tomli_w

from hil.cli import main
from hil.config.bench import BenchConfig
from hil.config.loading import load_bench
from hil.recording.mcap_reader import read_cycles
from hil.report.history.index import find_results
from tests.patience import PATIENT, patient_bench

SQUARE = "x,y,theta\n0,0,0\n0.06,0,0\n0.06,0.04,0\n"
LIMIT_S = 600.0

pytestmark = [
    pytest.mark.timeout(900),  # the first process to start may compile the estimators
    pytest.mark.usefixtures("warm_commands"),
]


def live(folder, *options, **process):
    """A running `hil live` in a folder, on an emulated bench that allows for a busy host."""
    bench = patient_bench(folder, "emulated")
    return subprocess.Popen(
        [sys.executable, "-m", "hil.cli", "live", "--bench", str(bench), *options, "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        **process,
    )


def commanded(process):
    """Where a running `hil live` takes velocity commands, and the token that it asks for."""
    port, token = re.search(r"udp:(\d+), token ([0-9a-f]{32})", process.stderr.readline()).groups()
    return ("127.0.0.1", int(port)), token


def verified(path):
    """What `hil replay --verify --json` says, with its exit code."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        code = main(["replay", str(path), "--verify", "--json"])
    return code, json.loads(out.getvalue())


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A short drive with everything on: its folder and its summary."""
    folder = tmp_path_factory.mktemp("live")
    (folder / "square.csv").write_text(SQUARE)
    names = {"--trajectory": "square.csv", "--record": "run.mcap", "--rerun": "run.rrd"}
    files = [word for option, name in names.items() for word in (option, str(folder / name))]
    process = live(folder, *files, "--observe", "ukf", "--observe", "odometry", "--duration", "2.5")
    out, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, err
    assert f"hil: wrote {folder / 'run.rrd'} (" in err
    assert err.index("the session ends after 2.5 s") < err.index("watched until it is held")
    return folder, json.loads(out)


def test_the_summary_says_what_happened(driven):
    folder, summary = driven
    assert summary["ended"] == "duration"
    timing = summary["timing"]
    for section in ("read", "estimate", "control", "write", "sinks", "work", "lateness"):
        assert timing[f"{section}_mean_ms"] <= timing[f"{section}_worst_ms"]
    assert timing["cycles"] + timing["skipped"] == pytest.approx(125, abs=10)
    assert summary["recording"]["dropped"] == summary["recording"]["lost"] == 0
    assert summary["recording"]["written"] == sum(1 for _ in read_cycles(folder / "run.mcap"))
    assert summary["samples"]["servos"]["missing"] == 0
    assert summary["monitor"]["failure"] == ""
    assert (folder / "run.rrd").read_bytes()[:3] == b"RRF"


def test_a_session_is_in_the_history(driven):
    folder, summary = driven
    (kept,) = find_results(folder)
    assert (kept.kind, kept.what, kept.bench) == ("live", "live", summary["bench"])
    assert summary["held"]["state"] in kept.why


def test_a_real_time_recording_repeats_bit_for_bit(driven):
    folder, _ = driven
    code, reported = verified(folder / "run.mcap")
    assert (code, reported["verdict"]) == (0, "identical")
    assert [r["references"] for r in reported["runs"]] == ["none", "computed"]
    assert reported["changed_versions"] == {}


def test_nothing_stands_still_while_the_loop_begins(driven):
    """Code is loaded and devices are drained before the first cycle; loading alone takes 300 ms."""
    folder, _ = driven
    records = [r for r in read_cycles(folder / "run.mcap") if r.reference is not None]
    estimate_ms = np.array([r.timing_ns["estimate"] for r in records]) / 1e6
    assert estimate_ms[0] < 150.0
    assert len(records[0].inputs.encoders) <= 20


def test_velocity_commands_move_and_silence_stops(tmp_path):
    """Commands by UDP for a while, then nothing: the dead man's time passes and the robot stands."""
    record = ("--record", str(tmp_path / "run.mcap"))
    process = live(tmp_path, "--command", "udp:0", "--dead-man", "0.3", *record, "--duration", "4")
    address, token = commanded(process)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        while process.poll() is None and not _moved(tmp_path / "run.mcap"):
            sender.sendto(b"v 0 0.05 0\n", address)  # anybody
            sender.sendto(f"{token} v 0.05 0 0\nnonsense\n".encode(), address)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(0.05)
    out, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, err
    summary = json.loads(out)
    assert summary["commands"]["accepted"] > 0
    assert summary["commands"]["without_token"] > 0
    assert summary["commands"]["refused"] > 0
    assert "`v VX VY W`" in err
    assert summary["commands"]["dead_man_stops"] >= 1  # more where this process was held up
    references = [r.reference for r in read_cycles(tmp_path / "run.mcap") if r.reference is not None]
    assert np.allclose(references[-1].twist_body, 0.0)
    assert references[-1].pose_in_wall[0] > references[0].pose_in_wall[0] + 0.01
    assert abs(references[-1].pose_in_wall[1] - references[0].pose_in_wall[1]) < 0.002
    assert verified(tmp_path / "run.mcap")[1]["verdict"] == "identical"


def _moved(path):
    """Whether the flushed part of a recording shows the reference under way."""
    if not path.exists() or path.stat().st_size < 60_000:
        return False
    found = [r for r in read_cycles(path, []) if r.reference is not None]
    return bool(found) and found[-1].reference.pose_in_wall[0] > found[0].reference.pose_in_wall[0] + 0.015


@pytest.mark.parametrize("name", ["SIGHUP", "SIGTERM"])
def test_a_signal_holds_the_robot_and_reports_all(tmp_path, name):
    """Only watching; a signal ends it with the summary and exit code 4."""
    process = live(tmp_path, "--record", str(tmp_path / "run.mcap"))
    while process.poll() is None and not _some(tmp_path / "run.mcap"):
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(0.1)
    os.kill(process.pid, getattr(signal, name))
    out, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 4, err
    summary = json.loads(out)
    assert summary["ended"] == name
    assert summary["held"]["state"] == "HELD"
    assert summary["held"]["moved_m"] < 0.005
    assert abs(summary["pose"][0]) < 0.01
    assert "at the start HELD: torque on" in err
    assert "since the stop" not in err
    assert summary["timing"]["cycles"] > 0
    records = list(read_cycles(tmp_path / "run.mcap"))
    assert all(r.reference is None for r in records)
    assert verified(tmp_path / "run.mcap")[1]["verdict"] == "identical"


@pytest.mark.parametrize("names", ["SIGINT SIGINT SIGINT", "SIGTERM SIGHUP"])
def test_a_second_signal_does_not_cut_short_how_the_robot_is_left(tmp_path, names):
    """The terminal's Ctrl-C goes to the emulated devices, too: they have to live for as long as the robot."""
    process = live(tmp_path, "--record", str(tmp_path / "run.mcap"), start_new_session=True)
    while process.poll() is None and not _some(tmp_path / "run.mcap"):
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(0.1)
    first, *others = names.split()
    for name in (first, *others):
        number = getattr(signal, name)
        with contextlib.suppress(ProcessLookupError):
            os.kill(process.pid, number) if name == "SIGTERM" else os.killpg(process.pid, number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(0.12)
    out, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 4, err
    summary = json.loads(out)
    assert summary["ended"] == first
    assert summary["held"]["state"] == "HELD", summary["held"]


def test_a_signal_before_the_session_begins_is_answered_with_the_summary(tmp_path):
    process = live(tmp_path, "--record", str(tmp_path / "run.mcap"))
    while "at the start" not in process.stderr.readline():
        assert process.poll() is None
    os.kill(process.pid, signal.SIGHUP)
    out, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 4, err
    summary = json.loads(out)
    assert summary["ended"] == "SIGHUP"
    assert summary["held"]["state"] == "HELD"


def _some(path):
    return path.exists() and path.stat().st_size > 150_000


def test_every_session_is_recorded_under_its_date_unless_asked_otherwise(tmp_path):
    process = live(tmp_path, "--duration", "0.5")
    out, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, err
    (folder,) = (tmp_path / "out" / "live").iterdir()
    assert re.fullmatch(r"\d{8}-\d{6}-\d{3}", folder.name)
    path = folder / "recording.mcap"
    assert f"recording to {path.relative_to(tmp_path)}" in err
    reported = json.loads(out)["recording"]
    assert reported["path"] == str(path.relative_to(tmp_path))
    assert reported["written"] == sum(1 for _ in read_cycles(path)) > 0
    assert verified(path)[1]["verdict"] == "identical"


@pytest.mark.skipif(not os.path.ismount("/sys"), reason="/sys is a folder like others here")
def test_a_disk_that_takes_no_files_is_named_before_anything_is_opened(capsys):
    assert main(["live", "--duration", "0.1", "--record", "/sys/run.mcap"]) == 2
    said = capsys.readouterr().err
    assert "/sys/run.mcap" in said
    assert "at the start" not in said


def test_a_bench_that_does_not_open_says_in_its_summary_why(tmp_path, capsys):
    absent = tmp_path / "none.toml"
    absent.write_text('schema = 1\nname = "none"\n[imu]\nport = "/dev/absent"\n')
    assert main(["live", "--bench", str(absent), "--no-record", "--json"]) == 3
    summary = json.loads(capsys.readouterr().out)
    assert "/dev/absent" in summary["ended"]
    assert summary["timing"]["cycles"] == 0


@pytest.mark.parametrize(("policy", "code"), [("stop", 4), ("go-on", 0)])
def test_a_disk_that_fills_up_stops_the_robot_or_not(tmp_path, policy, code):
    """The thread that writes finds no room while the robot is driven; no other files are touched."""
    path = tmp_path / "run.mcap"
    options = ("--record", str(path), "--duration", "5", "--on-recording-failure", policy)
    process = live(tmp_path, "--command", "udp:0", *options)
    address, token = commanded(process)
    limited = False
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        while process.poll() is None:
            sender.sendto(f"{token} v 0.02 0 0\n".encode(), address)
            if not limited and _some(path):
                resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (250_000, 250_000))
                limited = True
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(0.05)
    out, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == code, err
    summary = json.loads(out)
    assert "File too large" in summary["recording"]["failure"]
    problems = []
    records = list(read_cycles(path, problems))
    assert len(records) == summary["recording"]["written"] > 0
    assert "ends early" in problems[0]
    if policy == "go-on":
        assert summary["ended"] == "duration"
        return
    assert str(path) in summary["ended"]
    assert summary["timing"]["cycles"] < 450


def test_what_contradicts_itself_is_refused():
    for options in (
        ["--trajectory", "a.csv", "--command", "stdin"],
        ["--command", "tcp:1"],
        ["--replay", "a.csv", "--command", "stdin"],
        ["--record", "a.mcap", "--no-record"],
    ):
        assert main(["live", *options]) == 2


def test_a_file_that_is_there_is_not_recorded_over(tmp_path, capsys):
    kept = tmp_path / "run.mcap"
    kept.write_text("precious")
    assert main(["live", "--duration", "0.1", "--record", str(kept)]) == 2
    said = capsys.readouterr().err
    assert f"--record {kept}" in said
    assert "recording to" not in said
    assert kept.read_text() == "precious"


def test_a_robot_that_is_left_not_held_is_no_session_that_ended_well(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(BenchConfig, "emulated_holders", lambda self: ("adhesion",))
    monkeypatch.setattr(BenchConfig, "elsewhere", lambda self: ("adhesion", "load_cells"))
    config = load_bench("emulated", overrides=PATIENT)
    tree = config.model_dump(mode="json", by_alias=True, exclude_none=True)
    (tmp_path / "bench.toml").write_bytes(tomli_w.dumps(tree).encode())
    code = main(["live", "--bench", "bench.toml", "--duration", "0.3", "--no-record", "--json"])
    reported = capsys.readouterr()
    held = json.loads(reported.out)["held"]
    assert (code, held["state"]) == (3, "NOT HELD")
    assert f"NOT HELD: {held['why']}" in reported.err
