"""Runs `hil emulate` as a child process: start it, read its endpoints, end it."""

import contextlib
import json
import logging
import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomli_w

from hil.config.bench import BenchConfig
from hil.core.errors import DeviceError

_LOG = logging.getLogger(__name__)

_START_S = 60.0
_END_S = 5.0


class EmulatorProcess:
    """A running `hil emulate` that ends with this process, even if this process is killed.

    Args:
        config: the bench configuration; its emulated devices are served.
        seed: seed of the emulated world.
        faults: fault specs.

    Raises:
        DeviceError: it did not start; contains its output.
    """

    def __init__(self, config: BenchConfig, *, seed: int, faults: Sequence[str]) -> None:
        with tempfile.NamedTemporaryFile("wb", suffix=".toml", delete=False) as file:
            free = {name: set(table.CHOSEN_BY_EMULATOR) for name, table in config.devices().items()}
            tree = config.model_dump(mode="json", by_alias=True, exclude_none=True, exclude=free)
            tomli_w.dump(tree, file)
        self._config = Path(file.name)
        command = [sys.executable, "-m", "hil.cli", "emulate", "--bench", file.name]
        command += ["--lifeline", "--await-start"]
        command += ["--only", ",".join(config.emulated()), "--seed", str(seed)]
        for spec in faults:
            command += ["--fault", spec]
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - closed with this object
        # A signal to the bench's process group must not end it: the bench needs it to hold the robot.
        self._child = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._said, start_new_session=True
        )
        try:
            self.endpoints: dict[str, Mapping[str, Any]] = json.loads(self._first_line())
        except ValueError:
            self._end()
            error = self._failed()
            self.close()
            raise error from None

    @property
    def pid(self) -> int:
        """Process id of the emulator."""
        return self._child.pid

    def begin(self) -> None:
        """Start world time; it stands still before, so that nothing happens to an unobserved robot."""
        if self._child.stdin is not None:
            with contextlib.suppress(OSError):
                self._child.stdin.write(b"\n")
                self._child.stdin.flush()

    def _first_line(self) -> bytes:
        assert self._child.stdout is not None
        descriptor, line = self._child.stdout.fileno(), b""
        deadline_s = time.monotonic() + _START_S
        while not line.endswith(b"\n"):
            left_s = deadline_s - time.monotonic()
            if left_s <= 0 or not select.select([descriptor], [], [], left_s)[0]:
                break
            piece = os.read(descriptor, 65536)
            if not piece:
                break
            line += piece
        return line

    def _words(self) -> str:
        self._said.seek(0)
        return last_words(self._said.read().decode(errors="replace"))

    def _failed(self) -> DeviceError:
        return DeviceError(
            "emulator",
            f"the emulated devices could not be served: {self._words() or 'no answer'}",
            expected="one JSON line of endpoints",
            remedy="run `hil emulate` by hand to see more",
        )

    def _end(self) -> None:
        if self._child.stdin is not None:
            self._child.stdin.close()
        try:
            self._child.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()

    def close(self) -> None:
        """End the emulator; log a warning if it had ended by itself. Idempotent; never raises."""
        stdin = self._child.stdin
        if stdin is not None and not stdin.closed and self._child.poll() is not None:
            _LOG.error(
                "the emulator of the devices has ended by itself: %s", self._words() or "without a word"
            )
        self._end()
        if self._child.stdout is not None:
            self._child.stdout.close()
        self._said.close()
        self._config.unlink(missing_ok=True)


def last_words(said: str) -> str:
    """Error message in the output of a child process, without progress lines and call chain."""
    text = f"\n{said.strip()}"
    begin = text.rfind("\nhil: ")
    return text[begin:].removeprefix("\nhil: ") if begin >= 0 else text.splitlines()[-1]
