"""Writes each verdict of a fault campaign at once as a JSON line, so that a campaign can be resumed.

The first line holds the bench and the version of this software. An incomplete last line is dropped; any other
damage is an error.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any

import hil
from hil.core.errors import DataError
from hil.core.result_names import FAULTS_CELLS, FAULTS_CELLS_BEFORE
from hil.fault_matrix.cases import Cell
from hil.fault_matrix.judge import CellVerdict, Measured
from hil.procedure.run_journal import drop_torn_line
from hil.support.atomic_files import refused
from hil.support.file_reading import json_object, read_bytes

_MOST_BYTES = 256 << 20


class KeptVerdicts:
    """Verdicts stored in a folder: earlier ones, and new ones that are appended.

    Args:
        folder: folder of the campaign; must exist.
        bench: name or file of the bench, as given by the user.
        resume: True to continue the existing file; otherwise it is renamed to `cells.before.jsonl`.

    Attributes:
        there: verdicts of an earlier run; empty for a new campaign.

    Raises:
        DataError: there is no file to resume, it is of another bench or version, it is damaged, or it cannot
            be written.
    """

    def __init__(self, folder: Path, bench: str, *, resume: bool) -> None:
        self._path = folder / FAULTS_CELLS
        head = {"bench": bench, "version": hil.__version__}
        try:
            if resume:
                self.there = _read(self._path, head)
                drop_torn_line(self._path)
            else:
                self.there = ()
                if self._path.exists():
                    os.replace(self._path, folder / FAULTS_CELLS_BEFORE)
                self._path.write_text(json.dumps(head) + "\n", encoding="utf-8")
            self._file = self._path.open("a", encoding="utf-8")
        except OSError as error:
            raise refused(self._path, error) from None

    def __enter__(self) -> KeptVerdicts:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def add(self, verdict: CellVerdict) -> None:
        """Append a verdict; raises `DataError` if it cannot be written."""
        try:
            self._file.write(json.dumps(asdict(verdict)) + "\n")
            self._file.flush()
        except OSError as error:
            raise refused(self._path, error) from None


def _read(path: Path, head: dict[str, str]) -> tuple[CellVerdict, ...]:
    """Return the stored verdicts; raises `DataError` or `OSError`."""
    if not path.exists():
        raise DataError(str(path), "is not there: no campaign to resume", remedy="leave --resume out")
    there: list[CellVerdict] = []
    try:
        *lines, _ = read_bytes(path, _MOST_BYTES).split(b"\n")
        was = json_object(lines[0] if lines else b"{}")
        if different := [key for key in head if was.get(key) != head[key]]:
            raise DataError(
                str(path),
                f"these verdicts are of another {' and '.join(different)}",
                expected=str(head),
                remedy="resume with the same bench and version, or leave --resume out",
            )
        for line in lines[1:]:
            there.append(_verdict(json_object(line)))
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(
            f"{path}:{len(there) + 2}", f"is no verdict of a cell ({error})", remedy="remove the line"
        ) from None
    return tuple(there)


def _verdict(tree: dict[str, Any]) -> CellVerdict:
    cell = Cell(**{**tree["cell"], "specs": tuple(tree["cell"]["specs"])})
    lists = {name: tuple(tree[name]) for name in ("why", "others", "told")}
    return CellVerdict(**{**tree, **lists, "cell": cell, "measured": Measured(**tree["measured"])})


def missing(cells: Sequence[Cell], there: Sequence[CellVerdict]) -> tuple[Cell, ...]:
    """Return the cells without a verdict."""
    done = {verdict.cell for verdict in there}
    return tuple(cell for cell in cells if cell not in done)
