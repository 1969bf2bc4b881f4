"""Compares two campaigns over the same cases, case by case: is the second better, with what confidence?

Both used the same worlds, so the difference of each case does not contain the variation between worlds. This
distinguishes two estimators or calibrations with far fewer runs than two averages would. A measurement with a
value in only one campaign makes no pair, and is listed.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from markupsafe import Markup
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from scipy import stats

from hil.core.errors import DataError, UsageError
from hil.core.result_names import CAMPAIGN_TABLE, LOST, PASSED, PLAN
from hil.report.page_figures import drawn_image
from hil.report.page_formats import environment, number
from hil.report.plot_style import PALETTE, new_figure, style
from hil.report.result_reader import wrong_shape
from hil.support.atomic_files import write_text
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
        """Option, file or package -> its value."""
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
    """Return differences between the plans of two campaigns: `key`, and its `values`, a dash for none.

    None if a plan is missing or cannot be read.
    """
    plans = [_read_plan(folder) for folder in (first, second)]
    if plans[0] is None or plans[1] is None:
        return None
    one, two = plans[0].given(), plans[1].given()
    found = [
        {"key": k, "values": [one.get(k, _NONE), two.get(k, _NONE)]} for k in dict.fromkeys([*one, *two])
    ]
    return [row for row in found if row["values"][0] != row["values"][1]]


def _read_plan(folder: Path) -> _Plan | None:
    try:
        return _Plan.model_validate(read_json(folder / PLAN))
    except (DataError, ValidationError):
        return None


_SURE = 0.95
_ROUNDING = 1e-9
"""Relative difference below which two values count as equal: it is rounding, not a change of the robot."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="allow", allow_inf_nan=False)


class _Measured(_Part):
    unit: str
    value: Annotated[float, Field(strict=True)] | None


class _Row(_Part):
    case: str
    verdict: str
    measurements: dict[str, _Measured]
    faults_not_met: list[str] = []

    @property
    def good(self) -> bool:
        """Whether the run kept its limits."""
        return self.verdict in PASSED

    @property
    def lost(self) -> bool:
        """Whether the run left no result."""
        return self.verdict == LOST

    @property
    def tested(self) -> bool:
        """Whether the run has a result and all its faults have acted."""
        return not (self.lost or self.faults_not_met)

    def value(self, name: str) -> float | None:
        """Return the value of a measurement; None without a value."""
        return self.measurements[name].value if name in self.measurements else None


class _Campaign(_Part):
    schema_version: Literal[1] = Field(alias="schema")
    procedure: str
    rows: list[_Row]


def is_campaign(folder: Path) -> bool:
    """Whether a folder holds the results of a campaign."""
    return (folder / CAMPAIGN_TABLE).is_file()


def compare_campaigns(first: Path, second: Path) -> dict[str, Any]:
    """Compare two campaigns case by case.

    Returns:
        JSON values: `procedure`, `folders`, `differences` (option, file or package, and its values in both;
        None if not known), `cases` (in both), `only_first`, `only_second`, `not_tested` (cases in both where
        one run was LOST or no cycle met one of its faults: they are left out below), `lost` (those of them
        where one run was LOST), `verdicts` (cases that only one passed, with the p value of the exact McNemar
        test), `measurements`: unit, number of pairs (cases with a value in both) `of` all cases, medians,
        mean difference (second minus first) with its 95 % interval (Student's t), p value of the Wilcoxon
        signed-rank test, and the differences by case; `missing`: cases
        without a value of a measurement, in the `first` and in the `second`.

    Raises:
        DataError: a folder does not hold the results of a campaign.
        UsageError: the campaigns have different procedures, or no case in common.
    """
    trees = [_read(folder) for folder in (first, second)]
    if trees[0].procedure != trees[1].procedure:
        raise UsageError(
            f"campaigns of different procedures: {trees[0].procedure}, {trees[1].procedure}",
            expected="two campaigns of one procedure",
        )
    rows = [{row.case: row for row in tree.rows} for tree in trees]
    cases = [case for case in rows[0] if case in rows[1]]
    if not cases:
        raise UsageError(
            f"{first} and {second} have no case in common",
            expected="the same seeds and varied settings in both",
            remedy="put what differs into --set",
        )
    every = [(rows[0][case], rows[1][case]) for case in cases]
    pairs = [(a, b) for a, b in every if a.tested and b.tested]
    names = dict.fromkeys(name for pair in pairs for row in pair for name in row.measurements)
    return {
        "procedure": trees[0].procedure,
        "folders": [str(first), str(second)],
        "differences": differences(first, second),
        "cases": len(cases),
        "only_first": [case for case in rows[0] if case not in rows[1]],
        "only_second": [case for case in rows[1] if case not in rows[0]],
        "not_tested": [a.case for a, b in every if not (a.tested and b.tested)],
        "lost": [a.case for a, b in every if a.lost or b.lost],
        "verdicts": _verdicts(pairs),
        "measurements": [m for name in names if (m := _measurement(name, pairs)) is not None],
        "missing": [m for name in names if (m := _missing(name, pairs)) is not None],
    }


def _read(folder: Path) -> _Campaign:
    path = folder / CAMPAIGN_TABLE
    tree = read_json(path, remedy="name the folder of a campaign")
    try:
        return _Campaign.model_validate(tree)
    except ValidationError as error:
        raise DataError(str(path), f"is not the result of a campaign ({wrong_shape(error)})") from None


def _verdicts(pairs: Sequence[tuple[_Row, _Row]]) -> dict[str, Any]:
    better = [a.case for a, b in pairs if b.good and not a.good]
    worse = [a.case for a, b in pairs if a.good and not b.good]
    changed = len(better) + len(worse)
    p = float(stats.binomtest(len(better), changed).pvalue) if changed else 1.0
    good = [sum(pair[side].good for pair in pairs) for side in (0, 1)]
    return {"good": good, "better": better, "worse": worse, "p": p}


def _measurement(name: str, pairs: Sequence[tuple[_Row, _Row]]) -> dict[str, Any] | None:
    found = [(a.case, a.value(name), b.value(name)) for a, b in pairs]
    both = [(case, one, two) for case, one, two in found if one is not None and two is not None]
    if not both:
        return None
    values = np.array([(one, two) for _, one, two in both])
    change = values[:, 1] - values[:, 0]
    change[np.abs(change) <= _ROUNDING * np.abs(values).max(axis=1)] = 0.0
    some: dict[str, Any] = {
        "name": name,
        "unit": next(a.measurements[name].unit for a, _ in pairs if name in a.measurements),
        "pairs": len(both),
        "of": len(pairs),
        "medians": np.median(values, axis=0).tolist(),
        "change": float(change.mean()),
        "interval": None,
        "p": None,
        "changes": dict(zip([case for case, _, _ in both], change.tolist(), strict=True)),
    }
    if len(both) > 1 and np.ptp(change) > 0:
        interval = stats.ttest_1samp(change, 0.0).confidence_interval(_SURE)
        some["interval"] = [float(interval.low), float(interval.high)]
    if len(both) > 1 and np.any(change):
        some["p"] = float(stats.wilcoxon(change).pvalue)
    return some


def _missing(name: str, pairs: Sequence[tuple[_Row, _Row]]) -> dict[str, Any] | None:
    """Return cases without a value in the first and in the second; None if every case has both values."""
    first = [a.case for a, _ in pairs if a.value(name) is None]
    second = [b.case for _, b in pairs if b.value(name) is None]
    return {"name": name, "first": first, "second": second} if first or second else None


def campaigns_text(table: Mapping[str, Any]) -> str:
    """Return the comparison as text for a terminal."""
    one, two = table["verdicts"]["good"]
    untested, lost = len(table["not_tested"]), len(table["lost"])
    why = ", ".join(["no control cycle met a fault"] * (untested > lost) + [f"{lost} {LOST}"] * bool(lost))
    left_out = f", {untested} NOT TESTED ({why}) are left out" if untested else ""
    lines = [
        f"{table['procedure']}: {table['cases']} cases in both{left_out}; good: {one} and then {two} "
        f"(p = {table['verdicts']['p']:.2g})"
    ]
    for m in table["measurements"]:
        low_high = "" if m["interval"] is None else " [{} to {}]".format(*map(number, m["interval"]))
        sure = "" if m["p"] is None else f", p = {m['p']:.2g}"
        was, now = map(number, m["medians"])
        paired = "" if m["pairs"] == m["of"] else f" ({m['pairs']} of {m['of']} pairs)"
        lines.append(
            f"  {m['name']:42}{was:>11} ->{now:>11} {m['unit']:6} {m['change']:+.4g}{low_high}{sure}{paired}"
        )
    for m in table["missing"]:
        where = [f"{len(m[side])} cases of the {side}" for side in ("first", "second") if m[side]]
        lines.append(f"  {m['name']}: no value in {', '.join(where)}")
    return "\n".join([*lines, *_differing(table["differences"])])


def _differing(found: Sequence[Mapping[str, Any]] | None) -> list[str]:
    if found is None:
        return [f"what differs in their options is not known: a {PLAN} is missing or cannot be read"]
    if not found:
        return ["the same options, files and versions in both"]
    return ["differs:", *(f"  {row['key']}: {' -> '.join(row['values'])}" for row in found)]


def write_campaigns_page(path: Path, table: Mapping[str, Any]) -> Path:
    """Write the page.

    Raises:
        DataError: the file cannot be written.
    """
    differing = [m for m in table["measurements"] if any(m["changes"].values())]
    figures = [{"name": m["name"], "image": _figure(m)} for m in differing]
    alike = [_alike(m) for m in table["measurements"] if m not in differing]
    page = (
        environment()
        .get_template("campaigns_compare.html")
        .render(table=table, figures=figures, alike=alike, plan=PLAN)
    )
    return write_text(path, page)


def _alike(measured: Mapping[str, Any]) -> str:
    """Return the name of a measurement that is equal in all pairs; with their number if cases lack one."""
    pairs, of = measured["pairs"], measured["of"]
    return str(measured["name"]) if pairs == of else f"{measured['name']} ({pairs} of {of} pairs)"


def _figure(measured: Mapping[str, Any]) -> Markup:
    """Draw the difference of every case, sorted by size, and the mean with its interval."""
    change = np.sort(list(measured["changes"].values()))
    figure = new_figure(5.2, 2.1)
    unit = measured["unit"].replace("$", r"\$")
    axes = style(figure.add_subplot(), "cases, by their difference", f"second minus first ({unit})")
    axes.plot(np.arange(1, len(change) + 1), change, "o", ms=4, color=PALETTE["c1"], mec="none")
    axes.locator_params(axis="x", integer=True)
    axes.axhline(0.0, color=PALETTE["truth"], lw=1.0)
    if measured["interval"] is not None:
        axes.axhspan(*measured["interval"], color=PALETTE["c2"], alpha=0.25, lw=0)
    axes.axhline(measured["change"], color=PALETTE["c2"], lw=1.5)
    return drawn_image(figure, measured["name"])
