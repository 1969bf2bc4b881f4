"""A recording as a table (CSV, Parquet), and as a `Recording` for calibration.

The table starts with the columns of our plain CSV, so that an exported file can be evaluated and calibrated
like any other. Ground truth is interpolated to the wheels' instants between samples of motion capture at most
0.1 s apart, and is NaN elsewhere. Where motion capture is slower, only the instants next to its samples have
a value.
"""

import csv
import hashlib
import io
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from hil.core.clock import NS_PER_S
from hil.core.errors import UsageError
from hil.core.geometry import Array
from hil.core.signals import CycleRecord, WheelMeasurement
from hil.datasets.cleaning import Log
from hil.datasets.nominal_robot import Nominal
from hil.datasets.plain_csv import RATE_COLUMNS, TRUTH_COLUMNS, TRUTH_GAP_S, WHEEL_COLUMNS
from hil.datasets.recording_names import motion_of
from hil.datasets.sampling import truth_at
from hil.datasets.wheel_log import Recording, build_recording
from hil.recording.mcap_reader import read_cycles
from hil.support.atomic_files import refused, replacing
from hil.support.extras import how_to_install


def added_columns(records: Sequence[CycleRecord]) -> tuple[tuple[str, ...], Array]:
    """Names and values (cycles, names) of columns for the signal kinds that other packages add.

    A column is called `KIND_FIELD`. An array has one column per element (`bms_cell_v_0`, `bms_map_1_0`).
    `KIND_t` is the time of measurement, s since the first cycle. Texts and statuses have no columns. Values
    are NaN before a kind's first sample, and in a sample that is not good.
    """
    origin_ns = records[0].inputs.t_ns if records else 0
    rows: list[dict[str, float]] = []
    newest: dict[str, float] = {}
    names: dict[str, None] = {}
    for record in records:
        for kind, samples in record.inputs.added.items():
            if samples:
                found = dict(_numbers(kind, samples[-1]))
                found[f"{kind}_t"] = (samples[-1].stamp.t_ns - origin_ns) / NS_PER_S
                newest = {**newest, **found}
                names.update(dict.fromkeys(found))
        rows.append(newest)
    ordered = tuple(names)
    values = [[row.get(name, math.nan) for name in ordered] for row in rows]
    return ordered, np.array(values, dtype=np.float64).reshape(len(rows), len(ordered))


def _numbers(kind: str, sample: Any) -> Iterator[tuple[str, float]]:
    for field in fields(sample):
        value, name = getattr(sample, field.name), f"{kind}_{field.name}"
        if isinstance(value, (bool, int, float)):
            yield name, float(value)
        elif isinstance(value, np.ndarray) or _is_row(value):
            array = np.asarray(value, dtype=np.float64)
            for place in np.ndindex(array.shape):
                yield "_".join((name, *map(str, place))), float(array[place])


def _is_row(value: Any) -> bool:
    return isinstance(value, tuple) and bool(value) and all(isinstance(v, (bool, int, float)) for v in value)


_POSE = ("x_m", "y_m", "theta_rad")
COLUMNS = (
    "t",
    *WHEEL_COLUMNS,
    *TRUTH_COLUMNS,
    *RATE_COLUMNS,
    "cycle",
    *(f"estimate_{c}" for c in _POSE),
    *(f"estimate_{c}" for c in ("v_x_m_s", "v_y_m_s", "omega_rad_s")),
    *(f"sigma_{c}" for c in _POSE),
    *(f"reference_{c}" for c in _POSE),
    *(f"setpoint_w{i}_rad_s" for i in range(1, 5)),
    *(f"setpoint_delta{i}_rad" for i in range(1, 5)),
)


def _truth(records: Sequence[CycleRecord]) -> tuple[Array, Array]:
    """Stamps (m,), s since the first cycle, and poses (m, 3) of motion capture, in order of time."""
    origin_ns = records[0].inputs.t_ns if records else 0
    found = [m for r in records for m in r.measurements.mocap if m.valid and np.all(np.isfinite(m.pose))]
    t_s = np.array([(m.stamp.t_ns - origin_ns) / NS_PER_S for m in found])
    poses = np.array([m.pose for m in found], dtype=np.float64).reshape(-1, 3)
    order = np.argsort(t_s, kind="stable")
    return t_s[order], poses[order]


def tabulate(records: Sequence[CycleRecord]) -> Array:
    """Table of a recording: one row per wheel sample, columns `COLUMNS`; shape (n, len(COLUMNS))."""
    if not records:
        return np.empty((0, len(COLUMNS)))
    origin_ns = records[0].inputs.t_ns
    rows, stamps = [], []
    for record in records:
        tail = _cycle_columns(record)
        for wheels in record.measurements.wheels:
            stamps.append((wheels.stamp.t_ns - origin_ns) / NS_PER_S)
            rows.append([*wheels.wheel_angle_rad, *wheels.steering_rad, *wheels.wheel_rate_rad_s, *tail])
    t_s = np.array(stamps)
    body = np.array(rows, dtype=np.float64).reshape(len(t_s), -1)
    truth = truth_at(t_s, *_truth(records), longest_s=TRUTH_GAP_S)
    return (
        np.column_stack([t_s, body[:, :8], truth, body[:, 8:]]) if len(t_s) else np.empty((0, len(COLUMNS)))
    )


def _cycle_columns(record: CycleRecord) -> list[float]:
    state, reference, setpoint = record.state, record.reference, record.setpoint
    wanted = reference.pose_in_wall if reference is not None else [math.nan] * 3
    sigma = np.sqrt(np.maximum(np.diag(state.covariance)[:3], 0.0))
    return [
        float(record.cycle),
        *state.pose_body_in_wall,
        *state.twist_body,
        *sigma,
        *wanted,
        *setpoint.wheel_rate_rad_s,
        *setpoint.steering_rad,
    ]


def with_added(records: Sequence[CycleRecord]) -> tuple[tuple[str, ...], Array]:
    """Columns and rows (n, m) of `tabulate`, followed by the columns of `added_columns`."""
    names, values = added_columns(records)
    table = tabulate(records)
    if not names:
        return COLUMNS, table
    cycle = np.repeat(np.arange(len(records)), [len(r.measurements.wheels) for r in records])
    return (*COLUMNS, *names), np.column_stack([table, values[cycle]])


def write_table(records: Sequence[CycleRecord], path: Path, kind: str) -> tuple[int, tuple[str, ...]]:
    """Write the table; floats are exact in both formats. On failure an earlier file is kept.

    Returns:
        Number of rows, and the columns.

    Args:
        records: cycles in order.
        path: file to write.
        kind: `csv` or `parquet`.

    Raises:
        DataError: the file cannot be written.
        UsageError: unknown kind, or Parquet without its extra.
    """
    columns, table = with_added(records)
    writers = {"csv": _write_csv, "parquet": _write_parquet}
    if kind not in writers:
        raise UsageError(f"format {kind!r}", expected="csv or parquet")
    try:
        with replacing(path) as file:
            writers[kind](columns, table, file)
    except OSError as error:
        raise refused(path, error) from None
    return len(table), columns


def check_target(path: Path, kind: str) -> None:
    """Refuse to overwrite a file that is not an earlier export.

    Args:
        path: file to write.
        kind: `csv` or `parquet`.

    Raises:
        UsageError: the file exists and is not an export.
    """
    if path.is_file() and path.stat().st_size and not _is_export(path, kind):
        raise UsageError(
            f"{path}: exists already and is no export of a recording, and nothing else is written over",
            remedy="choose another --out, or remove it",
        )


def _is_export(path: Path, kind: str) -> bool:
    """Whether a file has the columns of an export."""
    if kind == "csv":
        first = ",".join(COLUMNS).encode()
        with path.open("rb") as file:
            return file.read(len(first)) == first
    parquet = _parquet()
    try:
        names = parquet.read_schema(str(path)).names
    except (OSError, ValueError):
        return False
    return tuple(names[: len(COLUMNS)]) == COLUMNS


def _write_csv(names: tuple[str, ...], table: Array, file: BinaryIO) -> None:
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    writer = csv.writer(text)
    writer.writerow(names)
    writer.writerows(["" if math.isnan(v) else repr(v) for v in row] for row in table.tolist())
    text.detach()


def _write_parquet(names: tuple[str, ...], table: Array, file: BinaryIO) -> None:
    parquet = _parquet()
    import pyarrow

    columns = {name: pyarrow.array(table[:, i], from_pandas=True) for i, name in enumerate(names)}
    parquet.write_table(pyarrow.table(columns), file)  # pandas' rule: NaN is null


def _parquet() -> Any:
    """Import pyarrow's Parquet module; raises `UsageError` where it is missing or broken."""
    try:
        import pyarrow.parquet
    except ModuleNotFoundError:
        raise UsageError(
            "Parquet needs pyarrow, which is not installed", remedy=how_to_install("parquet")
        ) from None
    except Exception as error:
        raise UsageError(
            f"Parquet needs pyarrow, which is installed but broken ({error})",
            remedy="install it again, or use --format csv",
        ) from None
    return pyarrow.parquet


def _wheel_log(samples: Iterable[WheelMeasurement], origin_ns: int) -> Log:
    usable = [w for w in samples if all(w.valid)]
    values = [[*w.wheel_angle_rad, *w.steering_rad, *w.wheel_rate_rad_s] for w in usable]
    return Log(
        np.array([(w.stamp.t_ns - origin_ns) / NS_PER_S for w in usable]),
        np.array(values, dtype=np.float64).reshape(-1, 12),
    )


def to_recording(
    path: str | Path, problems: list[str] | None = None, nominal: Nominal | None = None
) -> Recording:
    """Read one of our MCAP recordings as input of evaluation and calibration.

    Args:
        path: the MCAP file; the motion is its name without the number of a repetition.
        problems: list that receives the parts that could not be read; None to raise on damage.
        nominal: robot that it is read for, see `build_recording`.

    Raises:
        DataError: unreadable, or without wheels or ground truth.
    """
    file = Path(path)
    records = list(read_cycles(file, problems))
    origin_ns = records[0].inputs.t_ns if records else 0
    truth_t_s, poses = _truth(records)
    return build_recording(
        file.stem,
        _wheel_log((w for r in records for w in r.measurements.wheels), origin_ns),
        Log(truth_t_s, poses),
        motion=motion_of(file.stem),
        sources=(str(file),),
        sha256=(hashlib.sha256(file.read_bytes()).hexdigest(),),
        nominal=nominal,
    )
