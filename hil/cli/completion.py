"""Answers completion requests of a shell; `hil.cli.completion_types` finds the words.

Messages would disturb the line that is being typed: an error during the search yields no words.
"""

from contextlib import redirect_stderr, redirect_stdout
from io import StringIO

import click
from click.shell_completion import BashComplete, CompletionItem, add_completion_class, get_completion_class

from hil.core.errors import EXIT_PASS, EXIT_USAGE, UsageError

_BREAKS = (":", "=")


def answer(cli: click.Command, variable: str, asked: str) -> int:
    """Print the completion script or the words that a shell requests.

    Args:
        cli: the command whose line is being typed.
        variable: name of the environment variable that holds the request.
        asked: the request, such as `bash_source` or `bash_complete`.

    Returns:
        The exit code.
    """
    shell, _, what = asked.partition("_")
    found = get_completion_class(shell)
    if found is None or what not in ("source", "complete"):
        error = UsageError(
            f"{variable}={asked} is unknown", expected="bash_source, zsh_source or fish_source"
        )
        click.echo(f"hil: {error}", err=True)
        return EXIT_USAGE
    completion = found(cli, {}, "hil", variable)
    if what == "source":
        click.echo(completion.source())
        return EXIT_PASS
    words = ""
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()):  # scripts are run for their parameters
        try:
            completion.ctx_args["obj"], _ = completion.get_completion_args()
            words = completion.complete()
        except (Exception, SystemExit):
            return EXIT_PASS
    if words:
        click.echo(words)
    return EXIT_PASS


class _Bash(BashComplete):
    """Completion for bash, which splits `imu:stuck` and `--bench=lab` and replaces only the last part."""

    _begun = ""

    def get_completion_args(self) -> tuple[list[str], str]:
        """Like click's, with the parts of a split word joined again."""
        args, incomplete = super().get_completion_args()
        words: list[str] = []
        for word in (*args, incomplete):
            if words and (word in _BREAKS or words[-1].endswith(_BREAKS)) and not word.startswith("--"):
                words[-1] += word
            else:
                words.append(word)
        *args, incomplete = words
        self._begun = incomplete[: max(map(incomplete.rfind, _BREAKS)) + 1]
        return args, incomplete

    def format_completion(self, item: CompletionItem[str]) -> str:
        """Like click's, without the parts that bash does not replace."""
        return f"{item.type},{item.value.removeprefix(self._begun)}"


add_completion_class(_Bash)
