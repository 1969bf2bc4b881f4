"""Runs `hil` on a bench that several people share: waits for its labgrid place, and brings the results back.

    python run_on_place.py [--filter robot=4wis4wid] OUT run wall_tracking --bench /home/robot/bench.toml

Everything after OUT, a new folder here, follows `hil` on the bench's computer. The exit code is that of
`hil`. Ctrl-C stops the robot and waits until it is held. Whatever ends this program, the robot is held and
the place free soon after: `keep_run.py` beside the bench sees to that.

Needs `labgrid-client` on PATH, LG_COORDINATOR, and an SSH key that the bench's computer knows.
"""

import argparse
import getpass
import io
import os
import shlex
import socket
import subprocess
import sys
import tarfile
import threading
import time
from pathlib import Path
from typing import IO

REMOTE = "python3 keep_run.py"
BEAT_S = 1.0
FAILED = 3


def client(*words: str, token: str = "", kept: bool = True) -> str:
    """Call labgrid-client; returns what it printed, or lets the caller see it."""
    done = subprocess.run(
        ["labgrid-client", *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE if kept else None,
        env={**os.environ, **({"LG_TOKEN": token} if token else {})},
        text=True,
        check=True,
    )
    return done.stdout or ""


def acquired(tags: str) -> tuple[str, str]:
    """Wait until a place with these tags is free, and acquire it; returns its name and the reservation."""
    token = client("reserve", "--shell", *tags.split(",")).strip().partition("LG_TOKEN=")[2]
    try:
        client("wait", token, kept=False)
        return client("-p", "+", "acquire", token=token).split()[-1], token
    except BaseException:
        client("cancel-reservation", token)
        raise


def beat(line: IO[bytes]) -> None:
    """Let the other end know that this program lives, until the line is closed."""
    try:
        while True:
            line.write(b".")
            line.flush()
            time.sleep(BEAT_S)
    except (OSError, ValueError):
        return


def run(place: str, command: list[str], out: Path, remote: str) -> tuple[int, bool]:
    """Run `hil` on the place; returns its exit code, and whether the other end frees the place."""
    host = os.environ.get("LG_HOSTNAME", socket.gethostname())
    caller = f"{host}/{os.environ.get('LG_USERNAME', getpass.getuser())}"
    there = f"results-{time.time_ns()}"
    asked = f"{remote} {shlex.join([place, caller, there, *command])}"
    process = subprocess.Popen(
        ["labgrid-client", "-p", place, "ssh", asked],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C ends the run in order, not the connection
    )
    assert process.stdin is not None
    assert process.stdout is not None
    ready = process.stdout.readline() == b"ready\n"
    if ready:
        threading.Thread(target=beat, args=(process.stdin,), daemon=True).start()
    try:
        archive = process.stdout.read()
    except KeyboardInterrupt:
        print("the robot is stopped and looked at; its results come when it is held", file=sys.stderr)
        process.stdin.close()
        archive = process.stdout.read()
    if archive:
        unpack(archive, out)
    return process.wait(), ready


def unpack(archive: bytes, out: Path) -> None:
    """The results folder of the other computer, as one here."""
    with tarfile.open(fileobj=io.BytesIO(archive)) as files:
        files.extractall(out, filter="data")


def main() -> int:
    """Wait, run, bring back; returns the exit code of `hil`."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--filter", default="robot=4wis4wid", help="tags of the place [robot=4wis4wid]")
    parser.add_argument("--remote", default=REMOTE, help=f"how the bench's computer starts it [{REMOTE}]")
    parser.add_argument("out", type=Path, help="results folder here, which must not exist")
    parser.add_argument("command", nargs=argparse.REMAINDER, help="what follows `hil`")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True)
    place, token = acquired(asked.filter)
    ready = False
    try:
        code, ready = run(place, asked.command, asked.out, asked.remote)
    finally:
        if not ready:
            client("-p", place, "release")
        client("cancel-reservation", token)
    return code if ready else FAILED


if __name__ == "__main__":
    sys.exit(main())
