"""Compares several runs of one procedure: which measurement changed, and by how much."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hil.config.control import law_of
from hil.core.errors import UsageError
from hil.report.page_formats import environment, number, outcome_words
from hil.report.result_reader import read_result
from hil.report.run_summary import grouped
from hil.support.atomic_files import write_text

_NAMED = 3
_LINES = 8
"""Number of differences listed on the terminal."""
_GIVEN = ("seed", "faults", "emulated", "calibration")
"""Compared facts of a run, beside its parameters, configuration and versions."""
_FACTS = ("verdict", "started", "bench", "seed", "git_revision", "duration_s")


def compare(folders: Sequence[Path]) -> dict[str, Any]:
    """Compare the measurements and settings of several runs.

    Returns:
        JSON values: `procedure`, `runs` (facts by run), `measurements` (name, unit, values, outcomes,
        change from the first run to the last), `differences`: seed, faults, emulated devices, calibration,
        parameters, configuration and versions that differ, with the value in each run.

    Raises:
        DataError: a folder does not hold a result.
        UsageError: the results have different procedures.
    """
    trees = [read_result(f) for f in folders]
    names = sorted({t["procedure"] for t in trees})
    if len(names) > 1:
        raise UsageError(
            f"runs of different procedures: {', '.join(names)}", expected="runs of one procedure"
        )
    runs = [{"folder": str(f), **{k: t.get(k) for k in _FACTS}} for f, t in zip(folders, trees, strict=True)]
    for run, tree in zip(runs, trees, strict=True):
        run["calibration"] = (tree.get("calibration") or {}).get("version")
    return {
        "procedure": names[0],
        "runs": runs,
        "measurements": _measurements(trees),
        "differences": _differences(trees),
    }


def _measurements(trees: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    by_run = [{row["name"]: row for row in tree["measurements"]} for tree in trees]
    rows = []
    for name in dict.fromkeys(n for found in by_run for n in found):
        own = [found.get(name) for found in by_run]
        values = [row["value"] if row else None for row in own]
        first, last = values[0], values[-1]
        rows.append(
            {
                "name": name,
                "unit": next(row["unit"] for row in own if row),
                "values": values,
                "outcomes": [_outcome(row) for row in own],
                "change": None if first is None or last is None else last - first,
                "ratio": last / first if first and last is not None else None,
            }
        )
    return rows


def _outcome(row: Mapping[str, Any] | None) -> str:
    if row is None:
        return "absent"
    return outcome_words(row)["word"]


def _differences(trees: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    flat = [
        {key: v for part in _GIVEN for key, v in _leaves({part: _shown(t.get(part))})}
        | {
            f"{part}.{k}": v
            for part in ("parameters", "config", "versions")
            for k, v in _leaves(t.get(part) or {})
        }
        for t in trees
    ]
    keys = dict.fromkeys(k for tree in flat for k in tree)
    values = {k: [str(tree.get(k, "–")) for tree in flat] for k in keys}
    return [{"key": k, "law": law_of(k), "values": v} for k, v in values.items() if len(set(v)) > 1]


def _shown(value: Any) -> Any:
    """Return devices and faults as text; any other value unchanged."""
    return ", ".join(map(str, value)) if isinstance(value, list) else value


def _leaves(tree: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    out: list[tuple[str, Any]] = []
    for key, value in tree.items():
        out += _leaves(value, f"{prefix}{key}.") if isinstance(value, Mapping) else [(prefix + key, value)]
    return out


def comparison_text(table: Mapping[str, Any]) -> str:
    """Return the comparison as text for a terminal."""
    lines = [f"{table['procedure']}: {len(table['runs'])} runs"]
    lines += [f"  [{k}] {r['verdict']:9} {r['folder']}" for k, r in enumerate(table["runs"], start=1)]
    for row in table["measurements"]:
        values = "".join(f"{number(v):>12}" for v in row["values"])
        lines.append(f"{row['name']:44}{values} {row['unit']:8}{_change(row)}")
    differing = table["differences"]
    lines += [f"differs: {row['key']} {', '.join(row['values'])}{_of_law(row)}" for row in differing[:_LINES]]
    if len(differing) > _LINES:
        lines.append(f"{len(differing) - _LINES} more that differ are on the page")
    return "\n".join(lines)


def _of_law(row: Mapping[str, Any]) -> str:
    return f" (only the control law {row['law']!r} reads it)" if row["law"] else ""


def _change(row: Mapping[str, Any]) -> str:
    change = row["change"]
    return "" if change is None else f"{change:+.4g}" if change else "0"


def _sentence(table: Mapping[str, Any]) -> str:
    """Return a summary: verdicts of the first and last run, and measurements whose outcome changed."""
    first, last = table["runs"][0], table["runs"][-1]
    turned = [row["name"] for row in table["measurements"] if row["outcomes"][0] != row["outcomes"][-1]]
    text = f"{first['verdict']} in the first run, {last['verdict']} in the last."
    if not turned:
        return f"{text} No measurement changed its outcome."
    more = f" and {len(turned) - _NAMED} more" if len(turned) > _NAMED else ""
    many = "1 measurement has" if len(turned) == 1 else f"{len(turned)} measurements have"
    return f"{text} {many} another outcome: {', '.join(turned[:_NAMED])}{more}."


def write_compare_page(path: Path, table: Mapping[str, Any]) -> Path:
    """Write the page.

    Raises:
        DataError: the file cannot be written.
    """
    page = (
        environment()
        .get_template("run_compare.html")
        .render(table=table, change=_change, sentence=_sentence(table), groups=grouped(table["measurements"]))
    )
    return write_text(path, page)
