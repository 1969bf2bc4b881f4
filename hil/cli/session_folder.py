"""The folder of a live session: its recording, and `session.json`, by which the history finds it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.options import OUT
from hil.core.errors import DataError
from hil.core.result_names import LIVE_RECORDING, SESSION
from hil.support.atomic_files import check_folder, check_new_file, put_whole, refused

if TYPE_CHECKING:
    from hil.bench import Bench

_LISTED = ("ended", "held", "samples", "events", "recording", "commands", "first_cycle_s")

out_option = click.option(
    "--out", type=OUT, help="New folder of the session, for the history [default: out/live/TIME]."
)


class SessionFolder:
    """Folder of one session.

    Args:
        folder: folder that was named; None for a new one in `out/live`.
        command: name of the command that runs the session.
        moves: what it moves, for `hil jog`; else empty.

    Raises:
        DataError: a named folder already holds a session, or cannot be written.
    """

    def __init__(self, folder: Path | None, command: str, moves: str = "") -> None:
        began = datetime.now().astimezone()
        self.folder = folder or Path("out", "live", f"{began:%Y%m%d-%H%M%S-%f}"[:-3])
        if folder is not None:
            check_new_file(folder / SESSION, "--out")
            check_new_file(folder / LIVE_RECORDING, "--out")
        when = began.isoformat(timespec="seconds")
        self._reported: dict[str, Any] = {"command": command, "moves": moves, "began": when}

    def check(self) -> None:
        """Make sure, before anything opens, that it can be written; raises `DataError`."""
        try:
            check_folder(self.folder)
        except DataError as error:
            raise DataError("", error.message, remedy="name another folder with --out") from None

    @property
    def recording(self) -> Path:
        """Path of the recording, unless another was named."""
        return self.folder / LIVE_RECORDING

    def begin(self, bench: Bench) -> None:
        """Write what is known as the session begins; a session that is killed is listed by this."""
        emulated = bench.config.emulated()
        real = [name for name in bench.config.devices() if name not in emulated]
        self._reported |= {"bench": bench.config.name, "emulated": list(emulated), "real": real}
        self._reported["faults"] = list(map(str, bench.faults))
        self._write()

    def end(self, summary: Mapping[str, Any]) -> None:
        """Add from the summary of the session what a list shows."""
        self._reported |= {key: summary[key] for key in _LISTED if key in summary}
        self._write()

    def _write(self) -> None:
        """Write the file; only a message says that it could not be written, because the robot comes first."""
        path = self.folder / SESSION
        try:
            put_whole(path, json.dumps(self._reported).encode())
        except OSError as error:
            click.echo(f"hil: {refused(path, error)}; the session is missing from the history", err=True)
