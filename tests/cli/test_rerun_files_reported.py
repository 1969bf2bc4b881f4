"""What `--rerun` has written is said on stderr, with the command that opens it; without Rerun, at once."""

import shlex
import shutil
import struct

import pytest

from hil.cli import main, options

WHOLE = (
    b"RRF2".ljust(12, b"\0") + struct.pack("<QQ", 2, 2_340_000) + bytes(2_340_000) + bytes(16) + b"RRF2FOOT"
)
"""A Rerun file of one message, the end, and a footer."""


@pytest.fixture
def reported(tmp_path, monkeypatch, capsys):
    """Lines that are said of a view; files lie in the current folder."""
    monkeypatch.chdir(tmp_path)

    def tell(view):
        options.say_rerun_files(view)
        said = capsys.readouterr()
        assert said.out == ""
        return said.err.splitlines()

    return tell


def test_a_file_is_named_with_a_command_that_can_be_pasted(reported, tmp_path, monkeypatch):
    (tmp_path / "my run.rrd").write_bytes(WHOLE)
    monkeypatch.setattr(shutil, "which", lambda name: None)
    (line,) = reported("spawn, my run.rrd")
    words = shlex.split(line.partition("open it with: ")[2])
    assert words[-1] == "my run.rrd"
    assert words[0].startswith("/"), "rerun is not on the path"


def test_a_file_that_breaks_off_is_not_reported_as_written(reported, tmp_path):
    (tmp_path / "r.rrd").write_bytes(WHOLE[:-40])
    (line,) = reported("r.rrd")
    assert "incomplete" in line


@pytest.mark.parametrize("words", [("live", "--no-record"), ("replay", "absent.mcap")])
def test_without_rerun_it_is_refused_before_anything_is_opened_or_read(monkeypatch, capsys, words):
    monkeypatch.setattr("hil.monitor.sink.is_installed", lambda extra: False)
    monkeypatch.setattr("hil.bench.open_bench", lambda *_, **__: pytest.fail("a bench was opened"))
    assert main([*words, "--rerun", "x.rrd"]) == 2
    assert "Rerun" in capsys.readouterr().err
