"""Columns and units of another program's CSV, as the table `[columns]` of a `--topics` file, and its reader.

::

    schema = 2
    [columns]
    separator = ";"                            # optional: , (default) ; or a tab
    t = "time"
    phi = ["fl", "bl", "br", "fr"]             # or w alone, which is then integrated
    delta = ["fl_steer", "bl_steer", "br_steer", "fr_steer"]
    w = ["fl_rate", "bl_rate", "br_rate", "fr_rate"]   # optional
    x = "px"                                   # optional, with y and theta: the ground truth
    y = "py"
    theta = "yaw"
    drive_sign = [1, 1, 1, 1]                  # optional, as are the next two
    steer_sign = [1, 1, 1, 1]
    steer_zero_rad = [0.0, 0.0, 0.0, 0.0]
    [columns.units]                            # optional: s, rad, rad/s, m unless it says otherwise
    t = "ms"
    phi = "deg"
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from hil.core.errors import DataError, did_you_mean
from hil.core.geometry import Array

Names = tuple[str, str, str, str]
Four = tuple[float, float, float, float]
Signs = tuple[Literal[1, -1], Literal[1, -1], Literal[1, -1], Literal[1, -1]]
_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_ANGLE = {"rad": 1.0, "deg": math.pi / 180.0, "turns": math.tau}
_RATE = {"rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": math.tau / 60.0, "turns/s": math.tau}
_UNITS_OF = {
    "t": ("t", _TIME),
    "phi": ("phi", _ANGLE),
    "delta": ("delta", _ANGLE),
    "w": ("w", _RATE),
    "x, y": ("position", _LENGTH),
    "theta": ("theta", _ANGLE),
}
_SAME = 1e-3
_NAMED, _SHOWN = 12, 40


class Table(BaseModel):
    """Base of the tables of a `--topics` file: unknown keys are rejected."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Units(Table):
    """Units of the columns; x and y have one."""

    t: Literal["s", "ms", "us", "ns"] = "s"
    phi: Literal["rad", "deg", "turns"] = "rad"
    delta: Literal["rad", "deg", "turns"] = "rad"
    w: Literal["rad/s", "deg/s", "rpm", "turns/s"] = "rad/s"
    position: Literal["m", "cm", "mm"] = "m"
    theta: Literal["rad", "deg", "turns"] = "rad"


class ColumnMap(Table):
    """Columns of a CSV file: time, wheels in the order FL, BL, BR, FR, and ground truth.

    Attributes:
        separator: character between two columns; with another than a comma, a comma may be the decimal point.
        t: time; phi: angles of the wheels; delta: of the steering; w: rates of the wheels.
        x, y, theta: ground truth.
        units: units of the columns.
    """

    separator: Literal[",", ";", "\t"] = ","
    t: str
    phi: Names | None = None
    delta: Names
    w: Names | None = None
    x: str | None = None
    y: str | None = None
    theta: str | None = None
    drive_sign: Signs = (1, 1, 1, 1)
    steer_sign: Signs = (1, 1, 1, 1)
    steer_zero_rad: Four = (0.0, 0.0, 0.0, 0.0)
    units: Units = Field(default_factory=Units)

    @model_validator(mode="after")
    def _complete(self) -> ColumnMap:
        problems = []
        if self.phi is None and self.w is None:
            problems.append("neither phi nor w is there: give the angles of the wheels, or their rates")
        if self.has_truth != any(one is not None for one in (self.x, self.y, self.theta)):
            problems.append("give x, y and theta together, or none of them")
        names = [column for _, column, _ in self.wanted()]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            problems.append(f"each column has one meaning, but these have several: {', '.join(twice)}")
        if problems:
            raise ValueError("; ".join(problems))
        return self

    @property
    def has_truth(self) -> bool:
        """Whether the file holds ground truth."""
        return None not in (self.x, self.y, self.theta)

    def wanted(self) -> Iterator[tuple[str, str, float]]:
        """Name of each quantity in plain CSV, its column here, and the factor to SI units."""
        units = self.units
        yield "t", self.t, _TIME[units.t]
        groups = (
            ("phi", self.phi, _ANGLE[units.phi], self.drive_sign),
            ("delta", self.delta, _ANGLE[units.delta], self.steer_sign),
            ("w", self.w, _RATE[units.w], self.drive_sign),
        )
        for name, columns, factor, signs in groups:
            for i, (column, sign) in enumerate(zip(columns or (), signs, strict=False), start=1):
                yield f"{name}{i}", column, sign * factor
        lengths, angle = _LENGTH[units.position], _ANGLE[units.theta]
        for name, own, factor in (
            ("x", self.x, lengths),
            ("y", self.y, lengths),
            ("theta", self.theta, angle),
        ):
            if own is not None:
                yield name, own, factor

    def units_by(self, factors: Mapping[str, float]) -> str:
        """Keys of `[columns.units]` with which numbers as read now are multiplied by factors.

        Args:
            factors: factor of each quantity, as in `hil.datasets.wrong_units.UnitError`.

        Returns:
            The keys with their values; empty where one of the units is none that can be given.
        """
        out = []
        for quantity, factor in factors.items():
            key, units = _UNITS_OF[quantity]
            wanted = factor * units[getattr(self.units, key)]
            same = [name for name, to_si in units.items() if math.isclose(to_si, wanted, rel_tol=_SAME)]
            if not same:
                return ""
            out.append(f'{key} = "{same[0]}"')
        return ", ".join(out)


def read_columns(path: Path, data: bytes, columns: ColumnMap) -> tuple[list[str], Array]:
    """Names as in plain CSV, and the rows (n, number of names) in SI units, NaN for empty fields.

    Args:
        path: the file, for messages.
        data: its content.
        columns: its columns.

    Raises:
        DataError: columns are missing or hold text; all such problems at once.
    """
    text = io.StringIO(data.decode("utf-8-sig", "replace"), newline="")
    rows = csv.reader(text, delimiter=columns.separator)
    header = [name.strip() for name in next(rows, [])]
    wanted = list(columns.wanted())
    problems = [_lacks(name, column, header) for name, column, _ in wanted if header.count(column) != 1]
    there = [(name, header.index(column), factor) for name, column, factor in wanted if column in header]
    found, bad = _numbers(rows, there, "," if columns.separator != "," else "")
    problems += [
        f"line {line} holds text in the column {header[at]}: {field[:_SHOWN]!r}" for line, at, field in bad
    ]
    if problems:
        more = f", and {len(header) - _NAMED} more" if len(header) > _NAMED else ""
        raise DataError(
            str(path),
            "; ".join(problems),
            expected=f"columns of numbers among {', '.join(header[:_NAMED])}{more}",
            remedy="correct [columns] of --topics, or the file",
        )
    if not len(found):
        raise DataError(str(path), "has a header but no rows")
    found *= [factor for _, _, factor in there]
    names = [name for name, _, _ in there]
    zero = dict(zip((f"delta{i}" for i in range(1, 5)), columns.steer_zero_rad, strict=True))
    for at, name in enumerate(names):
        i = int(name[-1]) - 1 if name in zero else 0
        found[:, at] -= columns.steer_sign[i] * zero.get(name, 0.0)
    return names, found


def _lacks(name: str, column: str, header: list[str]) -> str:
    if column in header:
        return f"has the column {column} ({name}) more than once"
    hint = did_you_mean(column, header)
    return f"lacks the column {column} ({name})" + (f", {hint}" if hint else "")


def _numbers(
    rows: Iterator[list[str]], wanted: list[tuple[str, int, float]], comma: str
) -> tuple[Array, list[tuple[int, int, str]]]:
    """Numbers (n, wanted), and line, column and text of the first field of each column that is none."""
    out: list[list[float]] = []
    bad: dict[int, tuple[int, int, str]] = {}
    for line, fields in enumerate(rows, start=2):
        if not any(fields):
            continue
        row = []
        for _, at, _ in wanted:
            field = fields[at].strip() if at < len(fields) else ""
            try:
                row.append(float(field.replace(comma, ".") if comma else field) if field else np.nan)
            except ValueError:
                bad.setdefault(at, (line, at, field))
                row.append(np.nan)
        out.append(row)
    return np.array(out, dtype=np.float64).reshape(-1, len(wanted)), list(bad.values())
