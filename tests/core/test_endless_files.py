"""Every file that an option or a configuration names is read to a limit; a pipe or a device is not read."""

import os
import resource
from contextlib import contextmanager
from pathlib import Path

import pytest

from hil.cli import main

ROOM_BYTES = 2 << 30
NAMED = [
    ("as5045.dbc", ["run", "latency", "--set", "bench.encoders.dbc={}"]),
    ("offsets.txt", ["run", "latency", "--set", "bench.imu.calibration_file={}"]),
    ("calibration.toml", ["run", "latency", "--set", "bench.calibration={}"]),
    ("calibration.toml", ["run", "latency", "--calibration", "{}"]),
    ("calibration.toml", ["calibration", "list", "{}"]),
    ("replayed.mcap", ["run", "latency", "--set", "bench.emulation.replay={}"]),
    ("faults.toml", ["run", "latency", "--fault", "{}"]),
    ("answers.txt", ["run", "steering_zero", "--answers", "{}"]),
    ("bench.toml", ["run", "latency", "--bench", "{}"]),
    ("way.csv", ["live", "--bench", "emulated_floor", "--duration", "1", "--trajectory", "{}"]),
    ("topics.toml", ["evaluate", "run.mcap", "--topics", "{}"]),
]
"""A file's name, and a command that reads it."""


@contextmanager
def little_memory():
    """Reading on and on ends in `MemoryError` instead of taking the machine along."""
    now_bytes = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (now_bytes + ROOM_BYTES, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


@pytest.mark.parametrize(("name", "arguments"), NAMED)
def test_a_file_far_too_large_is_refused_by_name(tmp_path, monkeypatch, capsys, name, arguments):
    monkeypatch.chdir(tmp_path)
    with (tmp_path / name).open("wb") as file:
        file.truncate(1 << 40)
    with little_memory():
        code = main([argument.format(tmp_path / name) for argument in arguments])
    reported = capsys.readouterr()
    assert (code, "Traceback" in reported.err) == (2, False), reported.err
    assert name in reported.err + reported.out


@pytest.mark.timeout(60)
@pytest.mark.parametrize("device", [False, True])
@pytest.mark.parametrize(
    ("name", "arguments"),
    [*NAMED, ("way.py", ["run", "{}"]), ("way.mcap", ["replay", "{}"]), ("way.mcap", ["evaluate", "{}"])],
)
def test_a_pipe_or_a_device_is_refused_by_name(tmp_path, monkeypatch, capsys, name, arguments, device):
    monkeypatch.chdir(tmp_path)
    if device:
        (tmp_path / name).symlink_to("/dev/zero")
    else:
        os.mkfifo(tmp_path / name)
    code = main([argument.format(tmp_path / name) for argument in arguments])
    reported = capsys.readouterr()
    assert (code, "Traceback" in reported.err) == (2, False), reported.err
    assert name in reported.err + reported.out


@pytest.mark.timeout(60)
def test_a_bench_that_cannot_be_read_is_not_suggested_for_itself(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "huge.toml").write_bytes(b"#" * (5 << 20))
    os.mkfifo(tmp_path / "pipe.toml")
    for name, why in (("huge.toml", "larger than 4 MiB"), ("pipe.toml", "not a file")):
        assert main(["run", "bring_up", "--dry-run", "--bench", name]) == 2
        reported = capsys.readouterr().err
        assert why in reported
        assert "did you mean" not in reported
