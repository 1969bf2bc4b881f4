"""The shell completes commands, and `--help` is quick because it imports no command."""

import subprocess
import sys

import pytest
from click.shell_completion import BashComplete

from hil.cli import cli


@pytest.mark.parametrize(
    ("words", "begun", "offered"),
    [([], "resu", "results"), (["results"], "tr", "trends"), (["run"], "--see", "--seed")],
)
def test_a_word_is_completed(words, begun, offered):
    found = BashComplete(cli, {}, "hil", "_HIL_COMPLETE").get_completions(words, begun)
    assert offered in [item.value for item in found]


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
