"""Watches standard output and standard error: without a reader, the command ends in an orderly way.

The reader may disappear (`| head`, a closed terminal); later output is discarded. A command that handles
SIGTERM, as those that drive a robot do, gets SIGTERM and ends with 4, unless its verdict was already known.
Any other command runs to its end, and its exit code is that of its result, whether the reader left before the
last line or after it. If the output fails for another reason (a full disk), the exit code is always 4, with
`Aborted` if the command does not handle SIGTERM. A character that the terminal's encoding lacks is escaped.

Also makes the `--json` object of a command that ends in an error.
"""

import errno
import io
import os
import signal
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from typing import Any

import click

from hil.core.errors import Aborted, HilError, reason_of

_STDOUT, _STDERR = 1, 2


@dataclass
class Answered:
    """Note that a command that still runs has written its JSON object; a later error then adds none."""

    already: bool = False


def error_as_json(error: HilError) -> dict[str, Any]:
    """What `--json` gives in place of a result: `message`, `expected`, `remedy`, `exit_code` and `frames`.

    `frames` are those of the user's own code, as in `result.json`.
    """
    from hil.core.call_chain import as_json, chain_of

    return {
        "message": error.message,
        "expected": error.expected,
        "remedy": error.remedy,
        "exit_code": error.exit_code,
        "frames": as_json(chain_of(error)),
    }


def print_user_calls(frames: Sequence[Mapping[str, Any]], where: str = "") -> None:
    """Print on standard error the calls in the user's code that led to an error, if there are any.

    Args:
        frames: frames of the calls, as in `result.json`.
        where: the step, in words.
    """
    from hil.core.call_chain import in_words
    from hil.support.file_reading import printable

    if frames:
        head = f"Calls in your code{where and ' '}{where}, the last one at the end:"
        click.echo(printable(f"{head}\n{in_words(frames)}"), err=True)


@contextmanager
def kept_for_json(wanted: bool) -> Iterator[None]:
    """If one JSON object is wanted, send other output, also of child processes, to stderr meanwhile."""
    if not wanted:
        yield
        return
    sys.stdout.flush()
    before = os.dup(_STDOUT)
    try:
        os.dup2(_STDERR, _STDOUT)
        with redirect_stdout(sys.stderr):
            yield
    finally:
        os.dup2(before, _STDOUT)
        os.close(before)


class _Raw(io.FileIO):
    """A standard stream; after the first write that fails, all output is discarded."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self.lost = ""
        self.reader_gone = False

    def write(self, data: Any, /) -> int:
        """Write to the reader; see the module for what happens when that fails."""
        try:
            return super().write(data)
        except OSError as error:
            first, self.lost = not self.lost, reason_of(error)
            self.reader_gone = error.errno == errno.EPIPE
            _to_nowhere(self.fileno())
            if first:
                _end_command(self.lost, reader_gone=self.reader_gone)
            return len(data)


def _to_nowhere(descriptor: int) -> None:
    nowhere = os.open(os.devnull, os.O_RDWR)
    os.dup2(nowhere, descriptor)
    if nowhere != descriptor:
        os.close(nowhere)


def unreadable() -> str:
    """Why standard output or standard error have no reader any more; empty while they have one."""
    raws = (getattr(getattr(stream, "buffer", None), "raw", None) for stream in (sys.stdout, sys.stderr))
    why = next((raw.lost for raw in raws if isinstance(raw, _Raw) and raw.lost), "")
    return f"the output cannot be written any more ({why})" if why else ""


def print_end(text: str, held: Mapping[str, Any]) -> None:
    """Print how a run ended; without a reader, standard error says at least how the robot was left.

    Args:
        text: the complete text.
        held: `Held.to_json` of the robot.
    """
    from hil.bench.hold.held_state import held_in_words

    click.echo(text)
    if unreadable():
        click.echo(held_in_words(held), err=True)


def _end_command(why: str, *, reader_gone: bool) -> None:
    if callable(signal.getsignal(signal.SIGTERM)):
        os.kill(os.getpid(), signal.SIGTERM)
    elif not reader_gone and threading.current_thread() is threading.main_thread():
        raise Aborted(f"the output cannot be written any more ({why})")


class Output:
    """Both standard streams of this process, watched. A closed standard input is read as an empty one.

    Raises:
        Aborted: one of them is closed from the beginning.
    """

    def __init__(self) -> None:
        closed = [n for n, s in (("output", sys.stdout), ("error", sys.stderr)) if s is None]
        while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
            pass  # so that no file of ours takes the place of a standard stream
        os.close(descriptor)
        if sys.stdin is None:
            sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115 - for as long as the process lasts
        if closed:
            raise Aborted(f"standard {' and '.join(closed)} closed: nothing was started")
        self._streams = [_watched(sys.stdout), _watched(sys.stderr)]
        sys.stdout, sys.stderr = (stream for stream, _ in self._streams)

    def finish(self) -> bool:
        """Write what is still buffered; returns whether nothing was lost to a reader."""
        for stream, _ in self._streams:
            try:
                stream.flush()
            except (Aborted, OSError):
                continue
        return not any(raw.lost and not raw.reader_gone for _, raw in self._streams)


def _watched(stream: Any) -> tuple[io.TextIOWrapper, _Raw]:
    stream.flush()
    raw = _Raw(stream.fileno())
    text = io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=stream.encoding,
        errors="backslashreplace" if stream.errors == "strict" else stream.errors,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )
    return text, raw
