"""Writes the runs of a campaign as Parquet while it runs: one small file per run, together one table.

`pandas.read_parquet(folder)`, `polars.read_parquet(folder + "/*.parquet")` and Dask read all these files.
There is one row per measurement, so that the columns are the same for every procedure.
"""

import io
from pathlib import Path
from typing import Any

from hil.campaign.table import Row
from hil.core.errors import DataError, reason_of
from hil.support.atomic_files import put_whole
from hil.support.extras import is_installed

_END = b"PAR1"
_NONE = {
    "measurement": None,
    "unit": None,
    "value": None,
    "outcome": None,
    "low": None,
    "high": None,
    "missing": None,
}


def write_rows(folder: Path, row: Row, *, over: bool = True) -> None:
    """Write the rows of one run; do nothing without a working extra `parquet`.

    An existing file is overwritten. If not `over`, only a missing or truncated file is written: a run that
    was finished earlier may have either.

    Columns: case, seed, settings (map of text to text), verdict, faults_not_met (list of text: those that
    met no cycle), exit_code, duration_s (s), error, measurement, unit, value (in `unit`), outcome, low, high,
    missing (why there is no value).

    Raises:
        DataError: the file cannot be written.
    """
    path = folder / f"{row.case.name}.parquet"
    if not is_installed("parquet") or not (over or _is_torn(path)):
        return
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except Exception:
        return
    text, number = pa.string(), pa.float64()
    schema = pa.schema(
        {
            "case": text,
            "seed": pa.int64(),
            "settings": pa.map_(text, text),
            "verdict": text,
            "faults_not_met": pa.list_(text),
            "exit_code": pa.int64(),
            "duration_s": number,
            "error": text,
            "measurement": text,
            "unit": text,
            "value": number,
            "outcome": text,
            "low": number,
            "high": number,
            "missing": text,
        }
    )
    own = {
        "case": row.case.name,
        "seed": row.case.seed,
        "settings": list(row.case.settings),
        "verdict": row.verdict,
        "faults_not_met": list(row.faults_not_met),
        "exit_code": row.exit_code,
        "duration_s": row.duration_s,
        "error": row.error,
    }
    measured: list[dict[str, Any]] = [{"measurement": name, **m} for name, m in row.measurements.items()]
    lines = [{**own, **values} for values in measured or [_NONE]]
    whole = io.BytesIO()
    parquet.write_table(pa.Table.from_pylist(lines, schema), whole)
    try:
        put_whole(path, whole.getvalue())
    except OSError as error:
        raise DataError(str(folder), f"cannot be written ({reason_of(error)})") from None


def _is_torn(path: Path) -> bool:
    """Whether a Parquet file is missing or does not end with the Parquet end marker."""
    try:
        return not path.read_bytes().endswith(_END)
    except OSError:
        return True
