"""Reads and validates `result.json` of a run, so that the pages can rely on the types of its values.

A results folder may come from an untrusted source, so files that it names are used only if they lie inside.
"""

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import quote

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from hil.core.errors import DataError
from hil.core.path_hints import meant
from hil.core.result_names import JOURNAL, PASSED, RESULT, RESULT_SCHEMA
from hil.support.file_reading import read_json

_SHOWN = 5

_Number = Annotated[float, Field(strict=True)] | None


class _Part(BaseModel):
    model_config = ConfigDict(extra="allow", allow_inf_nan=False)


class _Frame(_Part):
    file: str
    line: int
    function: str
    code: str = ""
    times: int = 1
    raised: str = ""


class _Problem(_Part):
    type: str
    message: str
    step: str = ""
    finished: bool = False
    frames: list[_Frame] = []


class _Held(_Part):
    state: str
    moved_m: _Number = None
    why: str = ""
    by: str | None = None
    confirmed: bool = False
    rests_on: list[str] = []


class _Event(_Part):
    t_s: float
    level: str
    device: str
    what: str
    count: int = 1
    last_s: float = 0.0
    bench: str = ""


class _Row(_Part):
    name: str
    unit: str
    value: _Number
    low: _Number = None
    high: _Number = None
    margin: _Number = None
    outcome: Literal["PASS", "MARGINAL", "FAIL", "NOT MEASURED"]
    limited: bool = True
    rationale: str = ""
    doubt: str = ""


class _Step(_Part):
    title: str
    depth: int = Field(default=0, ge=0, le=64)
    outcome: str = ""
    bench_s: _Number = None
    wall_s: _Number = None


class _Table(_Part):
    title: str
    head: list[str]
    rows: list[list[str]]
    note: str = ""


class _Figure(_Part):
    title: str
    path: str
    caption: str = ""


class _Attachment(_Part):
    name: str
    path: str


class _Calibration(_Part):
    path: str = ""
    version: int | str | None = None
    sha256: str = ""


class _Granted(_Part):
    key: str
    value: Any = None
    state: Literal["confirmed", "contradicted", "unconfirmed"]
    by: str = ""
    on: str | None = None
    says: Any = None
    difference: _Number = None
    within: _Number = None
    unit: str | None = None


class _Injected(_Part):
    fault: str
    at: Literal["chip", "link", "hand"]
    begun_s: float | None
    ended_s: float
    messages: int | None


class _Result(_Part):
    schema_version: Literal[1] = Field(alias="schema")
    procedure: str
    verdict: Literal["PASS", "MARGINAL", "FAIL", "ERROR", "ABORTED"]
    exit_code: int = 0
    error: _Problem | None = None
    held: _Held | None = None
    teardown_errors: list[_Problem] = []
    measurements: list[_Row]
    summary: str = ""
    headline: str = ""
    bench: str | None = None
    emulated: list[str] = []
    real: dict[str, str] = {}
    command: str = ""
    virtual_time: bool = False
    seed: int | None = None
    faults: list[str] = []
    faults_not_met: list[str] = []
    injected: list[_Injected] = []
    parameters: dict[str, Any] = {}
    config: dict[str, Any] = {}
    calibration: _Calibration | None = None
    versions: dict[str, Any] = {}
    loop: dict[str, Any] | None = None
    git_revision: str | None = None
    started: str | None = None
    duration_s: _Number = None
    bench_duration_s: _Number = None
    resumed: int = 0
    steps: list[_Step] = []
    tables: list[_Table] = []
    figures: list[_Figure] = []
    attachments: list[_Attachment] = []
    recordings: list[str] = []
    notes: list[str] = []
    events: list[_Event] = []
    taken_for_granted: list[_Granted] = []


def wrong_shape(error: ValidationError) -> str:
    """Describe the first validation errors of a file: place and reason."""
    wrong = [f"{'.'.join(map(str, e['loc'])) or 'file'}: {e['msg']}" for e in error.errors()[:_SHOWN]]
    return "; ".join(wrong)


def read_result(folder: Path) -> dict[str, Any]:
    """Read and validate `result.json` of a run.

    Raises:
        DataError: the file is missing, damaged, of another schema, has values of a wrong type, or a verdict
            that contradicts its measurements.
    """
    path = folder / RESULT
    remedy = "name a results folder of hil run"
    if not path.is_file() and folder.exists():
        raise _unfinished(folder) or DataError(
            str(folder), f"holds no {RESULT}", remedy=meant(folder) or remedy
        )
    tree = read_json(path, remedy=remedy)
    try:
        found: dict[str, Any] = _Result.model_validate(tree).model_dump(by_alias=True)
    except ValidationError as error:
        raise DataError(
            str(path),
            f"is not the result of a run ({wrong_shape(error)})",
            expected=f"schema {RESULT_SCHEMA}",
        ) from None
    if wrong := contradiction(found):
        raise DataError(
            str(path),
            f"contradicts itself: {wrong}",
            remedy="it was damaged or changed by hand; run it again",
        )
    return found


def _unfinished(folder: Path) -> DataError | None:
    """The error for the folder of a run that is still running or was killed; None for another folder."""
    from hil.report.history.index import in_use

    if not (folder / JOURNAL).is_file():
        return None
    if in_use(folder):
        return DataError(str(folder), f"is of a run that is still running: it has no {RESULT} yet")
    remedy = f"`hil run PROCEDURE --out {shlex.quote(str(folder))} --resume` continues it"
    if recordings := sorted(folder.glob("*.mcap")):
        remedy += f"; `hil replay {shlex.quote(str(recordings[0]))}` shows what was recorded until then"
    return DataError(str(folder), f"is of a run that was killed: it has no {RESULT}", remedy=remedy)


def contradiction(result: Mapping[str, Any]) -> str:
    """Return a contradiction between verdict, outcomes, values and errors of a result; empty for none."""
    verdict, rows = result["verdict"], result["measurements"]
    for row in rows:
        value, low, high = row["value"], row["low"], row["high"]
        beyond = value is not None and (
            (low is not None and value < low) or (high is not None and value > high)
        )
        if beyond and row["outcome"] in PASSED:
            return f"{row['name']} is {row['outcome']} with a value beyond its limit"
    failed = [row["name"] for row in rows if row["outcome"] == "FAIL"]
    if verdict in PASSED and failed:
        return f"verdict {verdict}, but {failed[0]} is FAIL"
    if verdict in PASSED and (result["error"] or result["teardown_errors"]):
        return f"verdict {verdict}, but it ended in an error"
    if verdict == "PASS" and any(row["outcome"] == "MARGINAL" for row in rows):
        return "verdict PASS, but a measurement is MARGINAL"
    return "verdict FAIL, but no measurement is" if verdict == "FAIL" and not failed else ""


def inside(folder: Path, path: str) -> Path | None:
    """Return a file of a results folder, links resolved; None for a path outside of the folder."""
    try:
        whole = (folder / path).resolve()
        return whole if whole.is_relative_to(folder.resolve()) else None
    except (OSError, ValueError, RuntimeError):
        return None


def address(folder: Path, path: str) -> str:
    """Return a path as a relative URL for a page in the folder; empty for a path outside of it."""
    return "" if inside(folder, path) is None or Path(path).is_absolute() else quote(path)


def own_file(folder: Path, name: str) -> Path:
    """Return the path at which to write a page of a results folder.

    Raises:
        DataError: a symbolic link has that name; its target is not trusted.
    """
    path = folder / name
    if path.is_symlink():
        raise DataError(str(path), "cannot be written (it is a symbolic link)", remedy="remove the link")
    return path
