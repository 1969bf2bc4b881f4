"""`python -m hil.console.job_process FOLDER`: records its PID, then becomes the command of that job.

The process is recorded before it touches a device, so that the stop server can stop it even if the page that
started it is gone.
"""

import json
import os
import signal
import sys
from pathlib import Path

from hil.console.jobs import COMMAND, PROCESS, STDERR, STDIN, STDOUT, STOPPED, identity
from hil.console.json_files import put_private


def main() -> None:
    """Record this process, take the files of the job as standard streams, become `hil`.

    A console that a script has started in the background ignores SIGINT, and its jobs would inherit that.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    folder = Path(sys.argv[1])
    words = json.loads((folder / COMMAND).read_text(encoding="utf-8"))["words"]
    put_private(folder / PROCESS, identity(os.getpid()))
    if (folder / STOPPED).exists():  # by a program that did not know this process yet
        return
    for descriptor, name, flags in (
        (0, STDIN, os.O_RDWR),
        (1, STDOUT, os.O_WRONLY | os.O_CREAT),
        (2, STDERR, os.O_WRONLY | os.O_CREAT),
    ):
        file = os.open(folder / name, flags, 0o600)
        os.dup2(file, descriptor)
        os.close(file)
    os.execv(sys.executable, [sys.executable, "-m", "hil", "--progress", "json", *words])


if __name__ == "__main__":
    main()
