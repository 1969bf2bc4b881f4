"""The HTML page of a campaign: shares of good runs, a figure per measurement, every case."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from markupsafe import Markup

from hil.campaign.ineffective_settings import in_a_sentence
from hil.campaign.table import NEVER_SET, NOT_FINITE, Row, count, in_words, not_tested
from hil.core.result_names import REPORT, RUNS
from hil.report.page_figures import drawn_image
from hil.report.page_formats import environment
from hil.report.plot_style import PALETTE, new_figure, style
from hil.support.atomic_files import write_text

_ROWS_SHOWN = 500
_NAMED = 3


def write_campaign_page(path: Path, tree: Mapping[str, Any], rows: Sequence[Row]) -> Path:
    """Write the page and return its path.

    Args:
        path: the HTML file.
        tree: content of `campaign.json`.
        rows: all cases.

    Raises:
        DataError: the file cannot be written.
    """
    names = dict.fromkeys(n for row in rows for n in row.measurements)
    commands = {row["case"]: row["command"] for row in tree["rows"]}
    drawn = [name for name in names if _values(name, rows)]
    figures = [{"name": name, "image": _figure(name, rows)} for name in drawn]
    shown = sorted(rows, key=lambda row: row.good)[:_ROWS_SHOWN]
    page = (
        environment()
        .get_template("campaign.html")
        .render(
            campaign=tree,
            sentence=_sentence(rows),
            untested=sum(not row.tested for row in rows),
            alike=[in_a_sentence(found) for found in tree["alike"]],
            not_tested=not_tested,
            lost=sum(row.lost for row in rows),
            in_words=in_words,
            incomplete=any(m["missing"] for group in tree["groups"] for m in group["measurements"]),
            figures=figures,
            rows=shown,
            errors=any(row.error for row in shown),
            hidden=len(rows) - len(shown),
            names=list(names),
            reports=[_report(row) for row in shown],
            commands=[commands[row.case.name] for row in shown],
        )
    )
    return write_text(path, page)


def _sentence(rows: Sequence[Row]) -> str:
    """Return a summary: how many runs were good, why runs tested nothing, the limits missed most often."""
    tested, good = sum(row.tested for row in rows), sum(row.good for row in rows)
    if tested == len(rows):
        text = f"{good} of {tested} runs kept their limits."
    else:
        faults = count(spec for row in rows for spec in row.faults_not_met)
        why = not_tested(faults, sum(row.lost for row in rows))
        kept = f"{good} of the other {tested} kept their limits" if tested else "there are no others"
        text = f"{len(rows) - tested} of {len(rows)} runs tested nothing ({why}); {kept}."
    failed = [
        (n, m) for row in rows if row.tested for n, m in row.measurements.items() if m["outcome"] == "FAIL"
    ]
    for words, why in (
        ("Beyond its limit", ""),
        ("No finite number", NOT_FINITE),
        ("Never measured", NEVER_SET),
    ):
        if missed := Counter(name for name, m in failed if m["missing"] == why):
            text += f" {words}: {_most(missed)}."
    ended = sum(bool(row.error) and not row.lost for row in rows)
    return text + (f" {ended} ended early." if ended else "")


def _most(missed: Counter[str]) -> str:
    """Return measurements with their number of runs, the most frequent first."""
    more = f", and {len(missed) - _NAMED} more" if len(missed) > _NAMED else ""
    return ", ".join(f"{name} in {n}" for name, n in missed.most_common(_NAMED)) + more


def _report(row: Row) -> str:
    """Return the path of a run's report relative to the campaign's folder; empty without a report."""
    folder = Path(row.folder)
    return f"{RUNS}/{quote(folder.name)}/{REPORT}" if (folder / REPORT).exists() else ""


def _values(name: str, rows: Sequence[Row]) -> list[float]:
    """Return the finite values of the runs that have a result and whose faults have all acted."""
    found = (row.measurements.get(name) for row in rows if row.tested)
    return [m["value"] for m in found if m and m["value"] is not None]


def _figure(name: str, rows: Sequence[Row]) -> Markup:
    """Draw one column of dots per combination of settings, its median, and the limits."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row.case.group, []).append(row)
    first = next(row.measurements[name] for row in rows if name in row.measurements)
    figure = new_figure(max(3.4, 1.4 + 0.8 * len(groups)), 2.4)
    axes = style(figure.add_subplot(), "", first["unit"].replace("$", r"\$") if first["unit"] != "1" else "")
    for column, own in enumerate(groups.values()):
        values = np.array(_values(name, own))
        if len(values) == 0:
            continue
        offsets = np.linspace(-0.22, 0.22, len(values)) if len(values) > 1 else np.zeros(1)
        axes.plot(column + offsets, values, "o", ms=4, color=PALETTE["c1"], mec="none", alpha=0.8)
        axes.hlines(np.median(values), column - 0.3, column + 0.3, color=PALETTE["truth"], lw=1.5)
    for key in ("low", "high"):
        if first[key] is not None:
            axes.axhline(first[key], color=PALETTE["c5"], lw=1.0, ls="--")
    turned = 30 if len(groups) > 1 and max(map(len, groups)) > 10 else 0
    names = list(groups) if len(groups) > 1 else [""]
    axes.set_xticks(range(len(groups)), names, fontsize=8, rotation=turned)
    axes.set_xlim(-0.6, len(groups) - 0.4)
    return drawn_image(figure, name)
