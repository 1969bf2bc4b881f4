"""Every file that a configuration or an option names is read to a limit: one without an end is refused."""

import resource
from contextlib import contextmanager
from pathlib import Path

import pytest

from hil.cli import main

ROOM_BYTES = 2 << 30


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


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
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
    ],
)
def test_a_file_without_an_end_is_refused_by_name(tmp_path, monkeypatch, capsys, name, arguments):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).symlink_to("/dev/zero")
    with little_memory():
        code = main([argument.format(tmp_path / name) for argument in arguments])
    told = capsys.readouterr()
    assert (code, "Traceback" in told.err) == (2, False), told.err
    assert name in told.err + told.out
