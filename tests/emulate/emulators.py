"""`hil emulate` as a subprocess: started with options, asked for its line of endpoints, ended."""

import json
import subprocess
import sys
from contextlib import contextmanager
from types import SimpleNamespace

END_S = 20.0


@contextmanager
def emulator(*options):
    """A running emulator; its line is read when `endpoints` is called."""
    with subprocess.Popen(
        [sys.executable, "-m", "hil.cli", "emulate", *options],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield SimpleNamespace(process=process, endpoints=lambda: endpoints_of(process))
        finally:
            process.terminate()
            process.wait(END_S)


def endpoints_of(process):
    line = process.stdout.readline()
    assert line, process.stderr.read()
    return json.loads(line)
