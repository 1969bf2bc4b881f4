"""A module of ours run by another process, that takes over part of the work and never outlives this one."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def beside(
    module: str, *arguments: str, output: int = subprocess.DEVNULL
) -> Iterator[subprocess.Popen[bytes]]:
    """Within, a module runs in a process beside; it is waited for, or killed where an error ends the block.

    A signal to this process and its group is this one's: the other ends with it, as the pipe between them
    does, even if it is killed.

    Args:
        module: calls `end_with_parent` first of all.
        arguments: of its command line.
        output: where all goes that it says, as for `subprocess.Popen`.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", module, *arguments],
        stdin=subprocess.PIPE,
        stdout=output,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )
    with process:
        try:
            yield process
            process.wait()
        except BaseException:
            process.kill()
            raise


def last_words(said: str) -> str:
    """Why a process of ours has ended, of all that it said: its error, without progress and calls."""
    text = f"\n{said.strip()}"
    begin = text.rfind("\nhil: ")
    return text[begin:].removeprefix("\nhil: ") if begin >= 0 else text.splitlines()[-1]


def end_with_parent() -> None:
    """End this process, in the midst of whatever it does, as soon as the one that began it has ended."""

    def watch() -> None:
        os.read(0, 1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
