"""Runs `hil` on the bench's computer for a caller elsewhere, and frees the labgrid place when it is over.

    python keep_run.py [--silence S] PLACE CALLER OUT COMMAND...

`run_on_place.py` starts it through labgrid's SSH. COMMAND is what follows `hil`, and OUT its new results
folder. The caller sends a byte each second. When none comes for `--silence` seconds, or the caller's end of
the line is closed, SIGTERM ends the run: `hil` stops the robot, looks until it is held, and ends with 4.
The place is released only when `hil` has ended, and only if CALLER (HOST/USER) still has it.

To stderr goes what `hil` says, to stdout one line `ready`, and at the end OUT as a tar archive. Needs Python
and `labgrid-client` on PATH, and LG_COORDINATOR.
"""

import argparse
import contextlib
import os
import select
import signal
import subprocess
import sys
import tarfile
import threading
from pathlib import Path

IGNORED = (signal.SIGHUP, signal.SIGPIPE, signal.SIGINT, signal.SIGTERM)
"""What the loss of a connection may bring must not end this program before the robot is held."""


def heard(silence_s: float) -> bytes | None:
    """The caller's next bytes; empty when it has closed the line, None when it is silent."""
    ready, _, _ = select.select([0], [], [], silence_s)
    return os.read(0, 4096) if ready else None


def forward(process: "subprocess.Popen[bytes]") -> None:
    """Pass on what a process says, as long as the line takes it; read it in any case."""
    assert process.stdout is not None
    os.set_blocking(2, False)  # a line that is cut takes no more, and must not hold `hil` up
    for line in process.stdout:
        with contextlib.suppress(OSError):
            os.write(2, line)


def kept(command: list[str], silence_s: float) -> tuple[int, bool]:
    """Run `hil` as long as the caller is there; returns its exit code, and whether the line still is."""
    process = subprocess.Popen(
        ["hil", *command],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
        preexec_fn=lambda: [signal.signal(number, signal.SIG_DFL) for number in IGNORED],
    )
    speaking = threading.Thread(target=forward, args=(process,))
    speaking.start()
    said: bytes | None = b"."
    while said and process.poll() is None:
        said = heard(silence_s)
    if not said:
        process.terminate()
    code = process.wait()
    speaking.join()
    return code, said is not None


def hand_over(folder: Path) -> None:
    """Write a folder to stdout as a tar archive; a caller who has just gone does not get it."""
    with contextlib.suppress(OSError), tarfile.open(fileobj=sys.stdout.buffer, mode="w|gz") as archive:
        archive.add(folder, arcname=".")


def main() -> int:
    """Run what was asked for, and release the place; returns the exit code of `hil`."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--silence", type=float, default=10.0, help="seconds after which a caller is lost")
    parser.add_argument("place")
    parser.add_argument("caller", help="HOST/USER that has acquired the place")
    parser.add_argument("out", type=Path, help="results folder, which must not exist")
    parser.add_argument("command", nargs=argparse.REMAINDER, help="what follows `hil`")
    asked = parser.parse_args()
    for number in IGNORED:
        signal.signal(number, signal.SIG_IGN)
    try:
        os.write(1, b"ready\n")
        if not heard(asked.silence):
            return 4
        code, there = kept([*asked.command, "--out", str(asked.out)], asked.silence)
        if there and asked.out.is_dir():
            hand_over(asked.out)
        return code
    finally:
        subprocess.run(
            ["labgrid-client", "-p", asked.place, "release-from", asked.caller],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            check=False,
        )


if __name__ == "__main__":
    sys.exit(main())
