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
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from hil.core.clock import NS_PER_S
from hil.core.errors import UsageError
from hil.core.geometry import Array
from hil.core.signals import CycleRecord
from hil.datasets.cleaning import Log
from hil.datasets.nominal_robot import Nominal
from hil.datasets.plain_csv import RATE_COLUMNS, TRUTH_COLUMNS, TRUTH_GAP_S, WHEEL_COLUMNS
from hil.datasets.recording_names import motion_of
from hil.datasets.sampling import truth_at
from hil.datasets.wheel_log import Recording, build_recording
from hil.recording.mcap_reader import read_cycles
from hil.support.atomic_files import refused, replacing
from hil.support.extras import how_to_install


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


@dataclass(frozen=True)
class WheelTable:
    """Table of a recording.

    Attributes:
        columns: names of the columns: `COLUMNS`, then those of the signal kinds that other packages add:
            `KIND_FIELD`, with one column per element of an array (`bms_cell_v_0`, `bms_map_1_0`), none for
            texts and statuses, and `KIND_t`, the time of measurement in s since the first cycle. Values are
            NaN before a kind's first sample, and in a sample that is not good.
        values: one row per wheel sample, shape (n, columns).
        cycles: number of cycles of the recording.
    """

    columns: tuple[str, ...]
    values: Array
    cycles: int


def wheel_table(records: Iterable[CycleRecord]) -> WheelTable:
    """Table of a recording in one pass: of the cycles only the numbers of the table stay in memory."""
    origin_ns, cycles = 0, 0
    rows, cycle_of_row, truth = array("d"), array("q"), _Truth()
    newest: dict[str, float] = {}
    added: list[dict[str, float]] = []
    for cycles, record in enumerate(records, start=1):
        origin_ns = record.inputs.t_ns if cycles == 1 else origin_ns
        truth.take(record, origin_ns)
        newest = _with_newest(newest, record, origin_ns)
        added.append(newest)
        tail = _cycle_columns(record)
        for wheels in record.measurements.wheels:
            rows.append((wheels.stamp.t_ns - origin_ns) / NS_PER_S)
            rows.extend((*wheels.wheel_angle_rad, *wheels.steering_rad, *wheels.wheel_rate_rad_s, *tail))
            cycle_of_row.append(cycles - 1)
    body = np.array(rows, dtype=np.float64).reshape(-1, len(COLUMNS) - len(TRUTH_COLUMNS))
    poses = truth_at(body[:, 0], *truth.samples(), longest_s=TRUTH_GAP_S)
    names = tuple(dict.fromkeys(name for row in added for name in row))
    of_kinds = [[added[k].get(name, math.nan) for name in names] for k in cycle_of_row]
    kinds = np.array(of_kinds, dtype=np.float64).reshape(len(body), len(names))
    values = np.column_stack([body[:, :9], poses, body[:, 9:], kinds])
    return WheelTable((*COLUMNS, *names), values, cycles)


class _Truth:
    """Samples of motion capture, gathered cycle by cycle."""

    def __init__(self) -> None:
        self._samples = array("d")

    def take(self, record: CycleRecord, origin_ns: int) -> None:
        """Take the good samples of a cycle; `origin_ns` is the time of the first cycle."""
        for sample in record.measurements.mocap:
            if sample.valid and np.all(np.isfinite(sample.pose)):
                self._samples.extend(((sample.stamp.t_ns - origin_ns) / NS_PER_S, *sample.pose))

    def samples(self) -> tuple[Array, Array]:
        """Stamps (m,), s since the first cycle, and poses (m, 3), in order of time."""
        found = np.array(self._samples, dtype=np.float64).reshape(-1, 4)
        found = found[np.argsort(found[:, 0], kind="stable")]
        return found[:, 0], found[:, 1:]


def _with_newest(before: dict[str, float], record: CycleRecord, origin_ns: int) -> dict[str, float]:
    """Numbers of the newest sample of every kind that other packages add, by column."""
    found = before
    for kind, samples in record.inputs.added.items():
        if samples:
            found = {**found, **dict(_numbers(kind, samples[-1]))}
            found[f"{kind}_t"] = (samples[-1].stamp.t_ns - origin_ns) / NS_PER_S
    return found


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


def write_table(table: WheelTable, path: Path, kind: str) -> None:
    """Write a table; floats are exact in both formats. On failure an earlier file is kept.

    Args:
        table: the table.
        path: file to write.
        kind: `csv` or `parquet`.

    Raises:
        DataError: the file cannot be written.
        UsageError: unknown kind, or Parquet without its extra.
    """
    writers = {"csv": _write_csv, "parquet": _write_parquet}
    if kind not in writers:
        raise UsageError(f"format {kind!r}", expected="csv or parquet")
    try:
        with replacing(path) as file:
            writers[kind](table.columns, table.values, file)
    except OSError as error:
        raise refused(path, error) from None


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
    writer.writerows(["" if math.isnan(v) else repr(v) for v in row.tolist()] for row in table)
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
    file, truth, rows = Path(path), _Truth(), array("d")
    origin_ns: int | None = None
    for record in read_cycles(file, problems):
        origin_ns = record.inputs.t_ns if origin_ns is None else origin_ns
        truth.take(record, origin_ns)
        for w in record.measurements.wheels:
            if all(w.valid):
                rows.append((w.stamp.t_ns - origin_ns) / NS_PER_S)
                rows.extend((*w.wheel_angle_rad, *w.steering_rad, *w.wheel_rate_rad_s))
    wheels = np.array(rows, dtype=np.float64).reshape(-1, 13)
    return build_recording(
        file.stem,
        Log(wheels[:, 0], wheels[:, 1:]),
        Log(*truth.samples()),
        motion=motion_of(file.stem),
        sources=(str(file),),
        sha256=(hashlib.sha256(file.read_bytes()).hexdigest(),),
        nominal=nominal,
    )
