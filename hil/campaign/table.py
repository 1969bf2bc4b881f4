"""The results of a campaign: one row per case, statistics per combination of settings, CSV."""

import csv
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hil.campaign.cases import Case
from hil.core.errors import DataError, reason_of
from hil.core.result_names import LOST, PASSED
from hil.report.run_summary import was_set

_Z95 = 1.959963984540054
NOT_FINITE, NEVER_SET, ENDED_BEFORE = "no finite number", "never measured", "ended before"
"""Reasons why a run has no value for a measurement."""


@dataclass(frozen=True)
class Row:
    """One finished case.

    Attributes:
        measurements: name -> unit, value, outcome and limits, as the run reported them, and `missing`: why
            there is no value, empty where there is one.
        error: message of the error; empty without one.
        exit_code: exit code that `hil run` would have had.
        faults_not_met: specs of faults that met no control cycle: the run does not test them.
    """

    case: Case
    folder: str
    verdict: str
    exit_code: int
    duration_s: float
    measurements: dict[str, dict[str, Any]] = field(default_factory=dict)
    error: str = ""
    faults_not_met: tuple[str, ...] = ()

    @property
    def tested(self) -> bool:
        """Whether the run has a result and all its faults have acted."""
        return not (self.lost or self.faults_not_met)

    @property
    def lost(self) -> bool:
        """Whether the run left no result: its worker died or had no disk space; not the robot's fault."""
        return self.verdict == LOST

    @property
    def good(self) -> bool:
        """Whether the run kept its limits and all its faults have acted."""
        return self.tested and self.verdict in PASSED

    def to_json(self) -> dict[str, Any]:
        """Return a JSON object; the case becomes name, seed and settings."""
        tree = asdict(self)
        tree["case"] = self.case.name
        return {**tree, "seed": self.case.seed, "settings": dict(self.case.settings)}


def summarise(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return, per combination of settings, verdicts, share of good runs, and statistics of each measurement.

    Share and statistics cover the runs that have a result and in which all faults have acted (`tested`). The
    share is None without such a run.
    """
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row.case.group, []).append(row)
    return [_summary(name, own) for name, own in groups.items()]


def _summary(name: str, rows: Sequence[Row]) -> dict[str, Any]:
    tested = [row for row in rows if row.tested]
    good = sum(row.good for row in tested)
    low, high = wilson(good, len(tested))
    names = dict.fromkeys(n for row in tested for n in row.measurements)
    return {
        "group": name,
        "settings": dict(rows[0].case.settings),
        "n": len(rows),
        "tested": len(tested),
        "faults_not_met": count(spec for row in rows for spec in row.faults_not_met),
        "lost": sum(row.lost for row in rows),
        "verdicts": count(row.verdict for row in rows),
        "good": good,
        "pass_share": good / len(tested) if tested else None,
        "pass_share_95": [low, high],
        "measurements": [_statistics(n, tested) for n in names],
    }


def missing(row: Mapping[str, Any]) -> str:
    """Return why a measurement of `result.json` has no value; empty if it has one."""
    if row["value"] is not None:
        return ""
    if row["outcome"] == "NOT MEASURED":
        return ENDED_BEFORE
    return NOT_FINITE if was_set(row) else NEVER_SET


def _statistics(name: str, rows: Sequence[Row]) -> dict[str, Any]:
    """Return statistics of the `n` finite values; `missing`: why the other `of` - n runs have none."""
    found = [row.measurements[name] for row in rows if name in row.measurements]
    values = np.array([m["value"] for m in found if m["value"] is not None], dtype=np.float64)
    whys = [m["missing"] for m in found if m["missing"]] + [ENDED_BEFORE] * (len(rows) - len(found))
    first = found[0]
    some = {
        "name": name,
        "unit": first["unit"],
        "low": first["low"],
        "high": first["high"],
        "n": len(values),
        "of": len(rows),
        "missing": count(whys),
    }
    if len(values) == 0:
        return some | dict.fromkeys(("mean", "std", "min", "median", "p95", "max"))
    return some | {
        "mean": float(values.mean()),
        "std": float(values.std(ddof=1)) if len(values) > 1 else None,
        "min": float(values.min()),
        "median": float(np.median(values)),
        "p95": float(np.quantile(values, 0.95)),
        "max": float(values.max()),
    }


def count(words: Iterable[str]) -> dict[str, int]:
    """Count how often each word occurs, for example each verdict."""
    return dict(sorted(Counter(words).items()))


def in_words(counted: Mapping[str, int]) -> str:
    """Return counted reasons as text: `13 never measured, 2 ended before`."""
    return ", ".join(f"{n} {why}" for why, n in counted.items())


def not_tested(faults: Mapping[str, int], lost: int) -> str:
    """Return in how many runs no cycle met a fault, and how many are lost: `no cycle met imu:off@5 in 2`."""
    whys = [f"no cycle met {spec} in {n}" for spec, n in faults.items()]
    return ", ".join(whys + [f"{lost} {LOST}"] * bool(lost))


def wilson(good: int, total: int) -> tuple[float, float]:
    """Return the 95 % confidence interval of a share (Wilson's score interval): valid also for few runs."""
    if total == 0:
        return 0.0, 1.0
    share, square = good / total, _Z95 * _Z95
    centre = share + square / (2 * total)
    reach = _Z95 * math.sqrt(share * (1 - share) / total + square / (4 * total * total))
    scale = 1 + square / total
    return max(0.0, (centre - reach) / scale), min(1.0, (centre + reach) / scale)


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write one line per case: settings, verdict, faults that met no cycle, measurements; header with units.

    Raises:
        DataError: the file cannot be written.
    """
    keys = list(dict.fromkeys(k for row in rows for k, _ in row.case.settings))
    units = {n: m["unit"] for row in rows for n, m in row.measurements.items()}
    header = [
        "case",
        "seed",
        *keys,
        "verdict",
        "faults_not_met",
        "duration_s",
        *(f"{n} ({u})" for n, u in units.items()),
        "error",
    ]
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(header)
            for row in rows:
                settings = dict(row.case.settings)
                values = [row.measurements.get(n, {}).get("value") for n in units]
                writer.writerow(
                    [
                        row.case.name,
                        row.case.seed,
                        *(settings.get(k, "") for k in keys),
                        row.verdict,
                        "; ".join(row.faults_not_met),
                        f"{row.duration_s:.3f}",
                        *("" if v is None else repr(v) for v in values),
                        row.error,
                    ]
                )
    except OSError as error:
        raise DataError(str(path), f"cannot be written ({reason_of(error)})") from None
