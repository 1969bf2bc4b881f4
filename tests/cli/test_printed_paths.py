"""Paths are printed by one rule: below the current folder relative to it, else absolute."""

import re
from pathlib import Path

import pytest

from hil.cli import main
from hil.vocabulary.files import shown

SCRIPT = """
from hil.procedure import Measurement, procedure

@procedure(name="short", measurements=[Measurement("value", "m", high=1.0)])
def run(ctx):
    ctx.measure("value", 0.5)
"""
COMMANDS = {
    "run": ["run", "short.py", "--out"],
    "campaign": ["campaign", "short.py", "--seeds", "0:2", "--out"],
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    folder = tmp_path / "here"
    folder.mkdir()
    (folder / "short.py").write_text(SCRIPT)
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("given", ["relative", "absolute", "above"])
def test_a_command_prints_paths_by_the_rule(command, given, here, capsys):
    out = {"relative": Path("out/a"), "absolute": here / "out" / "a", "above": Path("../out")}[given]
    assert main([*COMMANDS[command], str(out)]) == 0
    told = re.findall(r"^(?:results|report|page): (.*)$", capsys.readouterr().out, re.M)
    assert told
    begin = str(here.parent / "out") if given == "above" else "out/a"
    for path in told:
        assert path.startswith(begin)
        assert Path(path).exists()


def test_a_path_is_printed_as_it_would_be_typed_here(here):
    assert shown(here / "a" / ".." / "b") == "b"
    assert shown(Path("b/c")) == "b/c"
    assert shown(here.parent / "here_too") == str(here.parent / "here_too")
