"""The shell completes a line, asking the program as it does; and `--help` is quick: it imports no command."""

import os
import subprocess
import sys

import pytest

SHELLS = ("bash", "zsh", "fish")


def _asked(environment, folder=None):
    """What the program says to a shell: nothing is said beside the answer."""
    done = subprocess.run(
        [sys.executable, "-m", "hil"], capture_output=True, text=True, env={**os.environ, **environment},
        cwd=folder, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def offered(shell, words, begun, folder=None):
    """The words that a shell is offered after these, for what has been begun."""
    line = {
        "COMP_WORDS": " ".join(["hil", *words, begun]),
        "COMP_CWORD": begun if shell == "fish" else str(len(words) + 1),
    }
    lines = _asked({"_HIL_COMPLETE": f"{shell}_complete", **line}, folder).splitlines()
    if shell == "zsh":
        return [value for kind, value in zip(lines[::3], lines[1::3], strict=True) if kind == "plain"]
    return [line.split(",", 1)[1].partition("\t")[0] for line in lines if line.startswith("plain,")]


@pytest.mark.parametrize("shell", SHELLS)
@pytest.mark.parametrize(
    ("words", "begun", "expected"),
    [([], "resu", "results"), (["results"], "tr", "trends"), (["run"], "--see", "--seed")],
)
def test_a_word_is_completed(shell, words, begun, expected):
    assert offered(shell, words, begun) == [expected]


@pytest.mark.parametrize("shell", SHELLS)
def test_a_line_that_nothing_completes_stays_as_it_is(shell):
    assert offered(shell, ["no-such-command"], "x") == []


@pytest.mark.parametrize("shell", SHELLS)
def test_the_script_of_a_shell_is_printed(shell):
    assert "_HIL_COMPLETE" in _asked({"_HIL_COMPLETE": f"{shell}_source"})


def test_a_shell_that_is_not_known_is_named():
    done = subprocess.run(
        [sys.executable, "-m", "hil"], capture_output=True, text=True, check=False,
        env={**os.environ, "_HIL_COMPLETE": "ash_source"},
    )  # fmt: skip
    assert done.returncode == 2
    assert "ash_source" in done.stderr
    assert "Traceback" not in done.stderr


def test_help_imports_no_command_and_nothing_heavy():
    """Within 0.2 s: what costs time is what is imported, whatever computer this is."""
    code = (
        "import sys; from hil.cli import main; main(['--help']); print(*sorted(sys.modules), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stderr.split())
    assert not {m.split(".")[0] for m in loaded} & {
        "numpy",
        "scipy",
        "pydantic",
        "matplotlib",
        "rich",
        "jinja2",
    }
    assert {m for m in loaded if m.startswith("hil.cli.")} <= {"hil.cli.options", "hil.cli.output"}
