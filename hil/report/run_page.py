"""The report of one run: a single, self-contained HTML file made from its results folder.

Order: summary and verdict, figures, measurements by device with their limits drawn, tables, and a folded
section to repeat the run. It needs no network and supports dark and light themes, phones, desktops and print.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from hil.core.call_chain import in_words
from hil.core.errors import DataError
from hil.core.result_names import REPORT, RESULT
from hil.report.page_figures import figure_image
from hil.report.page_formats import columns_of_words, digits_of, duration, environment, outcome_words
from hil.report.result_reader import address, inside, own_file, read_result
from hil.report.run_summary import grouped, sentence
from hil.support.atomic_files import write_text
from hil.support.file_reading import dotted

_BAR = 100.0


def write_run_page(folder: Path, out: Path | None = None) -> Path:
    """Write the page of a run to `out`, by default `report.html` beside `result.json`; return its path.

    Raises:
        DataError: the result cannot be read, one of its figures is missing or outside of the folder, or
            the page cannot be written.
    """
    tree = read_result(folder)
    rows = [
        row | {"bar": bar(row), "digits": digits_of(row)} | outcome_words(row) for row in tree["measurements"]
    ]
    judged = [row for row in rows if row["tone"] != "reported"]
    page = (
        environment()
        .get_template("run.html")
        .render(
            run=tree,
            title=tree["procedure"].replace("_", " "),
            sentence=sentence(tree),
            calls_in_words=in_words,
            groups=grouped(judged),
            reported=grouped([row for row in rows if row["tone"] == "reported"]),
            counts=counts(tree),
            figures=[f | {"image": _image(folder, f)} for f in tree["figures"]],
            tables=[table | {"words": columns_of_words(table["rows"])} for table in tree["tables"]],
            address=lambda path: address(folder, path),
            several=len({event["bench"] for event in tree["events"]}) > 1,
            parameters=_flat(tree["parameters"]),
            config=_flat(tree["config"]),
            duration=duration(tree["duration_s"]),
            driven=duration(tree["bench_duration_s"]),
        )
    )
    return write_text(own_file(folder, REPORT) if out is None else out, page)


def _image(folder: Path, figure: Mapping[str, Any]) -> Markup:
    path = inside(folder, figure["path"])
    if path is None:
        raise DataError(
            str(folder / RESULT),
            f"names a figure outside its folder ({figure['path']})",
            remedy="ask for a results folder that holds its own figures",
        )
    return figure_image(path, figure["title"])


def counts(tree: Mapping[str, Any]) -> dict[str, int]:
    """Count the measurements with limits by outcome."""
    found: dict[str, int] = {}
    for row in tree["measurements"]:
        if row.get("limited", True) or row["outcome"] == "FAIL":
            found[row["outcome"]] = found.get(row["outcome"], 0) + 1
    order = ("FAIL", "MARGINAL", "PASS", "NOT MEASURED")
    return {name: found[name] for name in order if name in found}


def bar(row: Mapping[str, Any]) -> dict[str, float] | None:
    """Return the position of a value between its limits, in percent of a bar; None without limits or value.

    The bar shows the allowed range with a quarter of it on either open side; a value beyond it is
    drawn at the end.
    """
    low, high, value = row["low"], row["high"], row["value"]
    if value is None or (low is None and high is None):
        return None
    if low is None:
        first, last = min(0.0, high * 1.25, high - 1e-12), max(high * 1.25, 0.0)
    elif high is None:
        reach = max(abs(low), abs(value - low), 1e-12) * 1.25
        first, last = min(0.0, low - 0.25 * reach), low + reach
    else:
        room = 0.2 * max(high - low, 1e-12)
        first, last = low - room, high + room
    span = max(last - first, 1e-12)

    def at(v: float) -> float:
        return float(round(min(max((v - first) / span, 0.0), 1.0) * _BAR, 2))

    start = 0.0 if low is None else at(low)
    end = _BAR if high is None else at(high)
    return {"start": start, "width": round(end - start, 2), "value": at(value)}


def _flat(tree: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [
        (key, json.dumps(value) if isinstance(value, list) else str(value))
        for key, value in dotted(tree)
        if value is not None
    ]
