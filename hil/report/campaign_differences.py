"""Finds the differences of two campaigns' inputs: options, files and versions, by their plans."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from hil.core.errors import DataError
from hil.core.result_files import PLAN
from hil.support.file_reading import read_json

_NONE = "–"
_DIGITS = 8


class _Plan(BaseModel):
    model_config = ConfigDict(extra="ignore")

    script: str
    bench: str | None = None
    emulate: str | None = None
    calibration: str | None = None
    settings: list[str] = []
    faults: list[str] = []
    contents: dict[str, str] = {}
    make: dict[str, str] = {}

    def given(self) -> dict[str, str]:
        """Option, file or package -> what it was."""
        given = {
            "SCRIPT": self.script,
            "--bench": self.bench,
            "--emulate": self.emulate,
            "--calibration": self.calibration,
            "--fault": ", ".join(self.faults),
        }
        settings = (text.partition("=") for text in self.settings)
        return {
            **{f"--set {key.strip()}": value for key, _, value in settings},
            **{key: value for key, value in given.items() if value},
            **{key: f"content {digest[:_DIGITS]}" for key, digest in self.contents.items()},
            **self.make,
        }


def differences(first: Path, second: Path) -> list[dict[str, Any]] | None:
    """What differs between the plans of two campaigns: `key`, and its `values` in both, a dash for none.

    None where a plan is missing or cannot be read.
    """
    plans = [_read(folder) for folder in (first, second)]
    if plans[0] is None or plans[1] is None:
        return None
    one, two = plans[0].given(), plans[1].given()
    found = [
        {"key": k, "values": [one.get(k, _NONE), two.get(k, _NONE)]} for k in dict.fromkeys([*one, *two])
    ]
    return [row for row in found if row["values"][0] != row["values"][1]]


def _read(folder: Path) -> _Plan | None:
    try:
        return _Plan.model_validate(read_json(folder / PLAN))
    except (DataError, ValidationError):
        return None
