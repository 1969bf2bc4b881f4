"""The public 4WIS4WID recordings: folders of `odom_N.csv[.gz]` and `abs_N.csv[.gz]`.

Format as in `dataset/` of the authors' repository (GitHub, JakVit/4WIS4WID_parameter_calibration):
`;`-separated, servo tuples in the file's own name order, receive time as text, header stamps as integers.
A file that cannot be parsed as one table is parsed row by row, which drops and counts broken rows.
"""

import hashlib
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array, Bools
from hil.core.signals import WHEELS
from hil.datasets.cleaning import NO_HEADING, UNIT_QUATERNION, Log, count, credible
from hil.datasets.nominal_robot import Nominal
from hil.datasets.number_table import numbers_at_once
from hil.datasets.sequence_times import on_period
from hil.datasets.truth_plane import check_plane
from hil.datasets.unpacking import read_packed
from hil.datasets.wheel_log import Recording, build_recording

_NAMES = tuple(f"{w}_Wheel" for w in WHEELS) + tuple(f"{w}_Position" for w in WHEELS)
_MANY, _LEAST_NS = 20, 1e6
_ODOM_COLUMNS = ("time", ".header.stamp.secs", ".header.stamp.nsecs", ".name", ".position", ".velocity")
_ABS_COLUMNS = (
    "time",
    ".header.stamp.secs",
    ".header.stamp.nsecs",
    ".pose.position.x",
    ".pose.position.y",
    ".pose.orientation.x",
    ".pose.orientation.y",
    ".pose.orientation.z",
    ".pose.orientation.w",
)
_WORDS = (".header.frame_id", ".name")
_TUPLES = (".position", ".velocity", ".effort")
_TO_COMMAS = bytes.maketrans(b";/:", b",,,")
_UP = "or let it stream with the z axis up"
_MAX_BROKEN_SHARE = 0.1
_SHOWN = 40
_FILE = re.compile(r"(odom|abs)_(?P<run>\w+)\.csv(\.gz)?")


def read_bytes(path: Path) -> bytes:
    """Content of a plain or gzip file; raises `DataError` when it is empty or cannot be read."""
    data = read_packed(path)
    if not data.strip():
        raise DataError(str(path), "is empty", expected="a header line and rows")
    return data


def find_pairs(folder: Path) -> list[tuple[Path, Path]]:
    """Pairs (odom, abs) of a folder, in order of their run; raises `DataError` for a lone odom file."""
    pairs = []
    for odom in sorted(folder.glob("odom_*.csv*"), key=_run_key):
        if _FILE.fullmatch(odom.name) is not None:
            pairs.append((odom, partner(odom)))
    return pairs


def is_pair_file(path: Path) -> bool:
    """Whether a file is named like half of a public pair."""
    return _FILE.fullmatch(path.name) is not None


def partner(odom: Path) -> Path:
    """The `abs` file of an `odom` file; prefers the one with the same compression.

    Raises:
        DataError: there is no such file.
    """
    alike = odom.name.replace("odom_", "abs_", 1)
    stem = alike.removesuffix(".gz")
    for name in (alike, stem + ".gz", stem):
        if (candidate := odom.with_name(name)).exists():
            return candidate
    raise DataError(str(odom), "has no ground truth", expected=f"{stem}[.gz] beside it")


def _run_key(path: Path) -> tuple[int, str, str]:
    match = _FILE.fullmatch(path.name)
    run = match["run"] if match else path.name
    return (int(run) if run.isdecimal() else 1 << 30, run, path.name)


def read_pair(odom: Path, absolute: Path, nominal: Nominal | None = None) -> Recording:
    """Read one run; `nominal` is the CAD model by default. The motion is classified from the data.

    Raises:
        DataError: missing columns, damaged file, no usable rows.
    """
    wheel_bytes, truth_bytes = read_bytes(odom), read_bytes(absolute)
    wheel_rows, names = _odom_numbers(odom, wheel_bytes)
    order = [names.index(n) for n in _NAMES]
    position, velocity = wheel_rows[:, 9:17][:, order], wheel_rows[:, 17:25][:, order]
    wheels = np.column_stack([position, velocity[:, :4]])
    truth_rows = _abs_numbers(absolute, truth_bytes)
    turned = _rotations(absolute, truth_rows)
    repairs = dict[str, int]()
    count(repairs, NO_HEADING, np.count_nonzero(~turned))
    truth_rows = truth_rows[turned]
    check_plane(str(absolute), truth_rows[:, 9:12], truth_rows[:, [15, 12, 13, 14]], _UP)
    qx, qy, qz, qw = truth_rows[:, 12:16].T
    yaw = np.arctan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
    truth = np.column_stack([truth_rows[:, 9], truth_rows[:, 10], yaw])
    notes = list[str]()
    recording = build_recording(
        odom.name.removesuffix(".gz").removesuffix(".csv"),
        _log(odom, "wheels", wheel_rows, wheels, notes),
        _log(absolute, "ground truth", truth_rows, truth, notes),
        sources=(str(odom), str(absolute)),
        sha256=tuple(hashlib.sha256(b).hexdigest() for b in (wheel_bytes, truth_bytes)),
        nominal=nominal,
        repairs=repairs,
    )
    return replace(recording, notes=(*notes, *recording.notes))


def _rotations(path: Path, rows: Array) -> Bools:
    """Mask of ground-truth rows (n, 16) whose quaternion is a rotation; unreadable rows count as such.

    Raises:
        DataError: no row holds a heading.
    """
    size = np.sum(rows[:, 12:16] ** 2, axis=1)
    out = np.asarray(~np.isfinite(size) | ((size > UNIT_QUATERNION[0]) & (size < UNIT_QUATERNION[1])))
    wrong = np.flatnonzero(~out)
    if len(wrong) < np.count_nonzero(np.isfinite(size)) or not len(wrong):
        return out
    shown = ", ".join(f"{q:.3g}" for q in rows[wrong[0], 12:16])
    raise DataError(
        str(path),
        f"none of {len(rows)} rows holds a heading: .pose.orientation is no rotation (the first: {shown})",
        expected="unit quaternions of a rigid body: odometry cannot be compared with positions alone",
        remedy="let the capture system track a rigid body of three markers, and record its pose",
    )


def _log(path: Path, kind: str, rows: Array, values: Array, notes: list[str]) -> Log:
    """Log with header stamps shifted by the median receive delay: the source's clock, without jitter.

    Where sequence numbers show the source's period, stamps are put on it, and `notes` gets a sentence.

    Raises:
        DataError: the parts of a second are not in nanoseconds.
    """
    largest = float(np.max(rows[np.isfinite(rows[:, 8]), 8], initial=0.0))
    if len(rows) >= _MANY and np.ptp(rows[np.isfinite(rows[:, 7]), 7]) > 1.0 and 0.0 < largest < _LEAST_NS:
        raise DataError(
            str(path),
            f"the largest .header.stamp.nsecs is {largest:.0f}: all stamps lie at the begin of their second",
            expected="nanoseconds, up to 999999999",
            remedy="multiply that column by 1000 if it is in microseconds, by 1000000 if in milliseconds",
        )
    days = rows[:, 0] * 372 + rows[:, 1] * 31 + rows[:, 2]
    receive = (days - days[0]) * 86400 + rows[:, 3] * 3600 + rows[:, 4] * 60 + rows[:, 5]
    header = (rows[:, 7] - rows[0, 7]) + rows[:, 8] * 1e-9
    regular = on_period(header, rows[:, 6])
    if regular is not header:
        notes.append(f"stamps of the {kind} are late by varying times: its sequence numbers give the times")
    delay = (receive - header)[np.isfinite(receive - header)]
    return Log(regular + (float(np.median(delay)) if len(delay) else 0.0), values, receive)


def _split_header(path: Path, data: bytes, needed: tuple[str, ...]) -> tuple[list[str], bytes]:
    head, _, body = data.partition(b"\n")
    columns = head.decode("utf-8", "replace").strip().lstrip("\ufeff").split(";")
    if len(columns) == 1 and ("," in columns[0] or "\t" in columns[0]):
        other = "commas" if "," in columns[0] else "tabs"
        raise DataError(
            str(path),
            f"has {other} between its columns",
            expected="semicolons in a file that is called odom_N.csv or abs_N.csv",
            remedy="write it with semicolons, or call a table of plain numbers between commas MOTION_K.csv",
        )
    missing = [c for c in needed if c not in columns]
    if missing:
        raise DataError(str(path), f"lacks the columns {', '.join(missing)}", expected=";".join(needed))
    if not body.strip():
        raise DataError(str(path), "has a header but no rows")
    return columns, body.rstrip() + b"\n"


def _odom_numbers(path: Path, data: bytes) -> tuple[Array, list[str]]:
    columns, body = _split_header(path, data, _ODOM_COLUMNS)
    fields = body.split(b"\n", 1)[0].decode("utf-8", "replace").split(";")
    names = re.findall(r"'([^']*)'|\"([^\"]*)\"", fields[5]) if len(fields) > 5 else []
    names = [one or other for one, other in names]
    if sorted(names) != sorted(_NAMES):
        raise DataError(str(path), "does not name its eight servos", expected=", ".join(_NAMES))
    constant = f";{fields[4]};{fields[5]};".encode()
    quick = body.replace(constant, b";").translate(_TO_COMMAS, b"() ")
    return _numbers(path, quick, body, columns, 33), names


def _abs_numbers(path: Path, data: bytes) -> Array:
    columns, body = _split_header(path, data, _ABS_COLUMNS)
    fields = body.split(b"\n", 1)[0].decode("utf-8", "replace").split(";")
    frame = fields[4] if len(fields) > 4 else ""
    quick = body.replace(f";{frame};".encode(), b";").translate(_TO_COMMAS, b" ")
    return _numbers(path, quick, body, columns, 16)


def _numbers(path: Path, quick: bytes, body: bytes, columns: list[str], width: int) -> Array:
    """Parse the rows of a CSV file as numbers, (n, width)."""
    return credible(_rows(path, quick, body, columns, width))


def _rows(path: Path, quick: bytes, body: bytes, columns: list[str], width: int) -> Array:
    """Rows (n, width); falls back to row-by-row parsing where the fast path fails."""
    found = numbers_at_once(quick, width)
    if found is not None:
        return found
    lines = body.decode("utf-8", "replace").splitlines()
    rows = [_row(line, width) for line in lines]
    good = [r for r in rows if r is not None]
    if len(rows) - len(good) > _MAX_BROKEN_SHARE * len(rows):
        first = next(k for k, row in enumerate(rows) if row is None)
        raise DataError(
            str(path),
            f"{len(rows) - len(good)} of {len(rows)} rows cannot be read; the first is line {first + 2}: "
            f"{_unreadable(columns, lines[first])}",
            expected="numbers in every row, at most a tenth of them damaged",
        )
    out = np.array(good, dtype=np.float64).reshape(-1, width)
    return np.vstack([out, np.full((len(rows) - len(good), width), np.nan)])


def _unreadable(columns: list[str], line: str) -> str:
    """Reason why a row cannot be read: the first column with wrong content."""
    fields = line.split(";")
    if len(fields) != len(columns):
        return f"it has {len(fields)} fields, its header {len(columns)}"
    for name, field in zip(columns, fields, strict=True):
        count = 6 if name == "time" else len(_NAMES) if name in _TUPLES else 1
        if name not in _WORDS and _row(field, count) is None:
            wanted = "a number" if count == 1 else f"{count} numbers"
            return f"{name} holds {field[:_SHOWN]!r}, not {wanted}"
    return "its columns do not hold the numbers that its header names"


def _row(line: str, width: int) -> list[float] | None:
    """Numbers of one row, None if there are not `width`; words (frame and servo names) are skipped."""
    bare = re.sub(r"\[[^\[\]]*\]", "", line)
    fields = re.split(r"[;/:,()\s]+", bare)
    try:
        numbers = [float(f) for f in fields if (f and not f.isidentifier()) or f.lower() == "nan"]
    except ValueError:
        return None
    return numbers if len(numbers) == width else None
