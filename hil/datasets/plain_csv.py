"""Plain CSV: `t,phi1..phi4,delta1..delta4,x,y,theta[,w1..w4]`, one file per run, SI units.

Names of columns may be in quotes. Ground truth may be empty or NaN in any row, and so may the wheels where
there is ground truth. The motion is the file name without the repetition number `_K`.
"""

import csv
import hashlib
import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array
from hil.datasets.cleaning import Log
from hil.datasets.column_map import ColumnMap, read_columns
from hil.datasets.nominal_robot import Nominal
from hil.datasets.number_table import numbers_at_once
from hil.datasets.partial_rows import hold_unchanged
from hil.datasets.public_csv import read_bytes
from hil.datasets.recording_names import motion_of
from hil.datasets.sampling import truth_at
from hil.datasets.truth_files import TruthFile, read_truth, refuse_truth_alone
from hil.datasets.wheel_log import Recording, build_recording
from hil.datasets.wrong_units import UnitError

WHEEL_COLUMNS = tuple(f"phi{i}" for i in range(1, 5)) + tuple(f"delta{i}" for i in range(1, 5))
TRUTH_COLUMNS = ("x", "y", "theta")
RATE_COLUMNS = tuple(f"w{i}" for i in range(1, 5))
_NEEDED = ("t", *WHEEL_COLUMNS, *TRUTH_COLUMNS)
_ANGLES = WHEEL_COLUMNS[:4]
_SHOWN = 40
_MCAP = b"\x89MCAP"
"""First bytes of every MCAP file."""
TRUTH_GAP_S = 0.1
"""Longest time between two samples of ground truth across which it is interpolated."""


def read_plain(
    path: Path, nominal: Nominal | None = None, truth: TruthFile | None = None, named: ColumnMap | None = None
) -> Recording:
    """Read one run; `nominal` is the CAD model by default.

    Ground truth in a file of its own takes the place of the columns x, y and theta, if there are any.

    Args:
        path: the file.
        nominal: robot that it is read for.
        truth: ground truth in a file of its own.
        named: columns and units of another program's file; without ground truth in them, and in a file of its
            own, the recording has none.

    Raises:
        DataError: missing or duplicate columns, damaged file, no usable rows.
    """
    data = read_bytes(path)
    refuse_truth_alone(path, data)
    columns, table = (
        _read_table(path, data, truth is not None) if named is None else read_columns(path, data, named)
    )
    lacking = dict[str, int]()
    columns, table = _with_wheels(columns, table, lacking)
    rates = RATE_COLUMNS if all(c in columns for c in RATE_COLUMNS) else ()
    wheels = [columns.index(c) for c in (*WHEEL_COLUMNS, *rates)]
    own_truth = truth is None and (named is None or named.has_truth)
    places = [columns.index(c) for c in TRUTH_COLUMNS] if own_truth else []
    t_s = table[:, columns.index("t")]
    for sensor in (wheels[:4], wheels[4:8], wheels[8:], places):
        hold_unchanged(t_s, table, sensor, lacking)
    seen = np.any(np.isfinite(table[:, places]), axis=1)
    read = np.any(np.isfinite(table[:, wheels]), axis=1) | ~seen
    log, poses = Log(t_s[read], table[read][:, wheels]), Log(t_s[seen], table[seen][:, places])
    sources, digests = [str(path)], [hashlib.sha256(data).hexdigest()]
    if truth is not None:
        robot = nominal if nominal is not None else Nominal()
        poses, source, digest = read_truth(truth, path, log, robot, lacking)
        sources.append(source)
        digests.append(digest)
    stem = path.name.removesuffix(".gz").removesuffix(".csv")
    try:
        return build_recording(
            stem,
            log,
            poses if own_truth or truth is not None else None,
            motion=motion_of(stem),
            sources=tuple(sources),
            sha256=tuple(digests),
            nominal=nominal,
            repairs=lacking,
        )
    except UnitError as error:
        keys = named.units_by(error.units) if named is not None else ""
        if not keys:
            raise
        message = error.message.removeprefix(f"{path}: ")
        raise UnitError(
            str(path), message, error.units, remedy=f"in [columns.units] of --topics that is {keys}"
        ) from None


def has_own_columns(path: Path) -> bool:
    """Whether the first line of a file holds the steering columns of plain CSV."""
    header = read_bytes(path).partition(b"\n")[0].decode("utf-8-sig", "replace")
    return set(WHEEL_COLUMNS[4:]) <= {name.strip().strip('"') for name in header.split(",")}


def _read_table(path: Path, data: bytes, truth_elsewhere: bool) -> tuple[list[str], Array]:
    """Names of the columns, complete, and the rows (n, number of columns)."""
    header, _, body = data.partition(b"\n")
    _check_text(path, data, header)
    first_line = header.decode("utf-8", "replace").lstrip("\ufeff").rstrip("\r")
    columns = [name.strip() for name in next(csv.reader([first_line]), [])]
    needed = [c for c in _NEEDED if not (truth_elsewhere and c in TRUTH_COLUMNS)]
    _check_complete(path, header, columns, needed)
    table = _table(path, data, body, columns)
    if len(table) == 0:
        raise DataError(str(path), "has a header but no rows")
    return columns, table


def _with_wheels(columns: list[str], table: Array, lacking: dict[str, int]) -> tuple[list[str], Array]:
    """Columns and rows with empty wheel angles where the file has none; `lacking` counts them."""
    absent = [c for c in WHEEL_COLUMNS if c not in columns]
    if not absent:
        return columns, table
    others = [c for c in columns if c and c not in (*_NEEDED, *RATE_COLUMNS)]
    beside = f", which also holds columns that are not read: {', '.join(others)}" if others else ""
    lacking[f"columns of wheel angles ({', '.join(absent)}) missing in the file{beside}"] = len(absent)
    return [*columns, *absent], np.column_stack([table, np.full((len(table), len(absent)), np.nan)])


def _check_complete(path: Path, header: bytes, columns: list[str], needed: list[str]) -> None:
    """Raise `DataError` for missing or duplicate columns; says what the first line holds in their place.

    The wheel angles may be missing as a whole where all wheel rates are there.
    """
    rates = all(c in columns for c in RATE_COLUMNS) and not any(c in columns for c in _ANGLES)
    missing = [c for c in needed if c not in columns and not (rates and c in _ANGLES)]
    if not missing:
        twice = [c for c in (*_NEEDED, *RATE_COLUMNS) if columns.count(c) > 1]
        if twice:
            raise DataError(
                str(path),
                f"has the columns {', '.join(twice)} more than once",
                expected="each once",
                remedy="delete the one that is not meant",
            )
        return
    line, bad = header.decode("latin-1"), header.decode("utf-8", "replace").find("\ufffd")
    if bad >= 0:
        raise DataError(
            str(path),
            f"its first line is not UTF-8 text: {line[max(0, bad - _SHOWN // 2) :][:_SHOWN]!r}",
            expected=",".join(needed),
            remedy="save it as UTF-8, with the names of the columns in its first line",
        )
    if len(missing) == len(needed):
        raise DataError(
            str(path),
            f"its first line holds no names of columns: {line[:_SHOWN]!r}",
            expected=",".join(needed),
            remedy="delete the lines before the names, or add the names",
        )
    alike = {c.lower(): c for c in columns}
    others = [f"{alike[c]} in place of {c}" for c in missing if c in alike]
    found = f" (it has {', '.join(others)})" if others else ""
    raise DataError(str(path), f"lacks the columns {', '.join(missing)}{found}", expected=",".join(needed))


def _check_text(path: Path, data: bytes, header: bytes) -> None:
    """Raise `DataError` for other formats: spreadsheet output, unclosed quotes, MCAP under this name."""
    if data.startswith(_MCAP):
        raise DataError(
            str(path), "is an MCAP recording", expected="CSV", remedy="give it a name that ends with .mcap"
        )
    if b"\0" in header:
        raise DataError(str(path), "is not UTF-8 text", expected="CSV as UTF-8, not UTF-16 or a spreadsheet")
    if b"\r" in data and b"\n" not in data:
        raise DataError(str(path), "has lines that end with \\r alone", expected="\\n or \\r\\n")
    if b"," not in header and (b";" in header or b"\t" in header):
        raise DataError(str(path), "has no comma in its header", expected="columns that commas separate")
    if b'"' in data:
        for number, line in enumerate(data.split(b"\n"), start=1):
            if line.count(b'"') % 2:
                raise DataError(str(path), f"line {number} has a quote that is not closed")


def _table(path: Path, data: bytes, body: bytes, columns: list[str]) -> Array:
    """Rows (n, number of columns) of a file; `body` is the file without its header."""
    width = len(columns)
    found = numbers_at_once(body.replace(b"\r\n", b"\n"), width)
    if found is not None:
        return found
    rows = []
    for number, fields in enumerate(_lines(path, data), start=2):
        if not fields:
            continue
        if len(fields) != width:
            raise DataError(str(path), f"line {number} has {len(fields)} fields", expected=str(width))
        row = []
        for name, field in zip(columns, fields, strict=True):
            try:
                row.append(_number(field))
            except ValueError:
                raise DataError(
                    str(path),
                    f"line {number} holds text in the column {name}: {field[:_SHOWN]!r}",
                    expected="numbers, or nothing",
                ) from None
        rows.append(row)
    return np.array(rows, dtype=np.float64).reshape(-1, width)


def _number(field: str) -> float:
    """Value of a field; NaN for an empty one.

    Raises `ValueError` also for what only Python reads as a number: `1_0`, digits of other scripts.
    """
    if not field.strip():
        return np.nan
    if "_" in field or not field.isascii():
        raise ValueError(field)
    return float(field)


def _lines(path: Path, data: bytes) -> Iterator[list[str]]:
    """Fields of every line after the header."""
    reader = csv.reader(io.StringIO(data.decode("utf-8", "replace"), newline=""))
    try:
        next(reader)
        yield from reader
    except csv.Error as error:
        raise DataError(
            str(path), f"line {reader.line_num + 1} is not CSV ({error})", expected="lines that end with \\n"
        ) from None


def write_plain(path: Path, recording: Recording) -> None:
    """Write a recording; ground truth is interpolated to the wheel rows, but not across a gap in it.

    Before the first and after the last pose, these poses hold for the longest gap (0.1 s).
    """
    truth = truth_at(
        recording.t_s, recording.truth_t_s, recording.truth_pose, longest_s=TRUTH_GAP_S, edge_s=TRUTH_GAP_S
    )
    columns = [recording.t_s, *recording.wheel_angle_rad.T, *recording.steering_rad.T, *truth.T]
    names = ["t", *WHEEL_COLUMNS, *TRUTH_COLUMNS]
    if recording.has_rates:
        columns += list(recording.wheel_rate_rad_s.T)
        names += RATE_COLUMNS
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows([f"{value:.9g}" for value in row] for row in np.column_stack(columns).tolist())
