"""Questions to the operator: asked at the terminal, or answered from a file or by another program.

The file holds one answer per line in the order of the questions, or `text of the question: answer`.
Empty lines and lines that start with `#` are skipped. With a file every procedure runs unattended.
"""

import sys
from abc import abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from hil.core.errors import Aborted, ConfigError, reason_of
from hil.support.file_reading import read_text

_MOST_BYTES = 1 << 20
_YES, _NO = ("", "y", "yes", "ok"), ("n", "no", "stop", "abort", "cancel", "quit", "exit", "q")
_EXPECTED = "Enter (an empty line), y, yes or ok to go on; no or stop to end it"


def tell(text: str) -> None:
    """Print a line for the operator on stderr; stdout is for results."""
    print(f"hil: {text}", file=sys.stderr, flush=True)


class Operator(Protocol):
    """The person at the bench, or a substitute that answers questions."""

    @abstractmethod
    def ask(self, question: str) -> str:
        """Return the answer; raises `Aborted` without one."""


class Terminal(Operator):
    """Asks on stderr and reads stdin, so that stdout stays free for results."""

    def ask(self, question: str) -> str:
        """Print the question and wait for a line."""
        if not sys.stdin.isatty():
            raise Aborted(
                f"there is no operator to answer {question!r}", remedy="give --answers FILE to run unattended"
            )
        sys.stderr.write(f"{question} ")
        sys.stderr.flush()
        line = sys.stdin.readline()
        if not line:
            raise Aborted(f"no answer to {question!r}")
        return line.strip()


class Lines(Operator):
    """Passes questions to a program, which writes one line to stdin for each.

    Args:
        tell: function that receives `("question", text)`, and `("answered", text of the answer)`.
    """

    def __init__(self, tell: Callable[[str, str], None]) -> None:
        self._tell = tell

    def ask(self, question: str) -> str:
        """Pass the question on and wait for a line."""
        self._tell("question", question)
        line = sys.stdin.readline()
        if not line:
            raise Aborted(f"no answer to {question!r}: standard input is closed")
        self._tell("answered", line.strip())
        return line.strip()


class Answers(Operator):
    """Answers from a file.

    Raises:
        ConfigError: the file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            lines = read_text(path, _MOST_BYTES).splitlines()
        except (OSError, ValueError) as error:
            raise ConfigError(
                f"{path}: cannot be read ({reason_of(error)})", remedy="name a file of answers by --answers"
            ) from None
        self._lines = [line.strip() for line in lines if line.strip() and not line.startswith("#")]

    def ask(self, question: str) -> str:
        """Return the line that names the question, else the next one; raises `Aborted` if none is left."""
        for number, line in enumerate(self._lines):
            if line.startswith(question) and line[len(question) :].lstrip().startswith(":"):
                del self._lines[number]
                return line[len(question) :].lstrip()[1:].strip()
        if not self._lines:
            raise Aborted(f"{self._path} has no answer left for {question!r}")
        return self._lines.pop(0)


def go_ahead(operator: Operator, question: str) -> str:
    """Ask the operator to do something and press Enter, until the answer confirms it; return the answer.

    Args:
        operator: operator that answers the question.
        question: instruction to the operator, and to press Enter then.

    Raises:
        Aborted: the answer is no or missing, or an answer from a file is neither yes nor no.
    """
    answer = operator.ask(question)
    while (word := answer.strip().lower()) not in _YES:
        if word in _NO:
            raise Aborted(f"{answer!r} was the answer to {question!r}: nothing moves")
        if not isinstance(operator, (Terminal, Lines)):
            raise Aborted(f"{answer!r} is no answer to {question!r}", expected=_EXPECTED)
        answer = operator.ask(f"{answer!r} is no answer; expected {_EXPECTED}: {question}")
    return answer
