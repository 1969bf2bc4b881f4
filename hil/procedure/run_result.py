"""Writes the result of a run to files: `result.json` (schema 1) and JUnit XML."""

import json
import math
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from hil.core.call_chain import in_words
from hil.core.errors import EXIT_ABORTED, EXIT_LIMIT_FAILED, EXIT_PASS, DataError, reason_of
from hil.core.event_rows import event_line
from hil.core.result_names import JUNIT, RESULT, RESULT_SCHEMA
from hil.core.rounding import digits_apart
from hil.procedure.measurements import Measurement, Verdict
from hil.support.atomic_files import put_whole
from hil.support.file_reading import printable

KEEPING = "keeping the results"
"""Step name of the error that is reported if the result could not be written."""


@dataclass(frozen=True)
class Failure:
    """An error and the step in which it occurred.

    Attributes:
        kind: name of the error.
        message: text of the error.
        step: step in which, or after which, it occurred.
        exit_code: exit code for this error.
        finished: True if the step was finished: the run ended between this step and the next.
        frames: call chain through the user's code, as `hil.core.call_chain.as_json` returns it.
    """

    kind: str
    message: str
    step: str
    exit_code: int
    finished: bool = False
    frames: tuple[Mapping[str, Any], ...] = ()

    def to_json(self) -> dict[str, object]:
        """Return the entry of `result.json`."""
        return {
            "type": self.kind,
            "message": self.message,
            "step": self.step,
            "finished": self.finished,
            "frames": list(self.frames),
        }

    @property
    def place(self) -> str:
        """The place of the error as text: `in 'scan'`, `after 'scan'`."""
        return f"{'after' if self.finished else 'in'} {self.step!r}"


@dataclass(frozen=True)
class Result:
    """The result of one run.

    Attributes:
        error: the first error; later ones are in `teardown_errors`.
        measurements: rows of `result.json`.
        facts: further keys of `result.json`.
    """

    procedure: str
    verdict: Verdict
    folder: Path
    measurements: list[dict[str, Any]]
    facts: Mapping[str, Any]
    error: Failure | None = None
    teardown_errors: tuple[Failure, ...] = field(default_factory=tuple)

    @property
    def exit_code(self) -> int:
        """Exit code: 0 pass, 1 a limit failed, 2 usage, 3 device, 4 aborted."""
        if self.verdict is Verdict.ABORTED:
            return EXIT_ABORTED
        if self.verdict is Verdict.ERROR:
            first = self.error or self.teardown_errors[0]
            return first.exit_code
        return EXIT_LIMIT_FAILED if self.verdict is Verdict.FAIL else EXIT_PASS

    def to_json(self) -> dict[str, Any]:
        """Return the content of `result.json`; keys may be added, never renamed."""
        from hil.report.run_summary import sentence

        found: dict[str, Any] = {
            "schema": RESULT_SCHEMA,
            "procedure": self.procedure,
            "verdict": self.verdict.value,
            "exit_code": self.exit_code,
            "error": self.error.to_json() if self.error else None,
            "teardown_errors": [e.to_json() for e in self.teardown_errors],
            "measurements": self.measurements,
            **self.facts,
        }
        clean: dict[str, Any] = _finite(found)
        return {**clean, "said": sentence(clean)}


def judge(
    declared: Sequence[Measurement],
    values: Mapping[str, float],
    earlier: Mapping[str, list[float]],
    measured_in: Mapping[str, str],
    doubts: Mapping[str, str],
    ended: bool,
) -> list[dict[str, Any]]:
    """Return the rows of the measurement table.

    Args:
        declared: declared measurements, in order.
        values: measured values by name.
        earlier: earlier values by name; a row without earlier values has no such key.
        measured_in: step of each measurement.
        doubts: reason why a measurement is in doubt or missing, by name; a row without a doubt has no such
            key.
        ended: True if the procedure reached its end; if so, a measurement that was never set fails.
    """
    rows = []
    for m in declared:
        value = values.get(m.name)
        missing = value is None and not ended
        rows.append(
            {
                "name": m.name,
                "unit": m.unit,
                "value": value,
                "low": m.low,
                "high": m.high,
                "marginal": m.marginal,
                "margin": None if value is None else m.margin(value),
                "outcome": "NOT MEASURED" if missing else m.judge(value).value,
                "limited": m.limited,
                "step": measured_in.get(m.name),
                "rationale": m.rationale,
                **({"earlier": earlier[m.name]} if m.name in earlier else {}),
                **({"doubt": doubts[m.name]} if doubts.get(m.name) else {}),
            }
        )
    return rows


def write_result(result: Result) -> Path:
    """Write `result.json` and `junit.xml` into the run's folder; returns the former.

    Raises:
        DataError: the folder cannot be written.
    """
    path = result.folder / RESULT
    tree = result.to_json()
    try:
        put_whole(path, (json.dumps(tree, indent=1, allow_nan=False) + "\n").encode())
        put_whole(result.folder / JUNIT, junit(tree).encode())
    except OSError as error:
        raise DataError(str(path), f"cannot be written ({reason_of(error)})") from None
    return path


def junit(tree: Mapping[str, Any]) -> str:
    """Return JUnit XML of a result: one test case per measurement, one for the run itself.

    Characters that are invalid in XML, or lone surrogates, are escaped.
    """
    name = tree["procedure"]
    rows = tree["measurements"]
    failures = sum(r["outcome"] == "FAIL" for r in rows)
    broken = tree["verdict"] in ("ERROR", "ABORTED")
    duration = f"{tree.get('duration_s') or 0.0:.3f}"
    suite = ElementTree.Element(
        "testsuite",
        name=f"hil.{name}",
        tests=str(len(rows) + 1),
        failures=str(failures),
        errors=str(int(broken)),
        skipped=str(sum(r["outcome"] == "NOT MEASURED" for r in rows)),
        time=duration,
        timestamp=str(tree.get("started", "")),
    )
    properties = ElementTree.SubElement(suite, "properties")
    calibration = tree.get("calibration") or {}
    for key, value in (
        ("verdict", tree["verdict"]),
        ("bench", tree.get("bench", "")),
        ("seed", tree.get("seed", "")),
        ("calibration_version", calibration.get("version", "none")),
        ("emulated", ",".join(tree.get("emulated", ())) or "none"),
        *((f"real.{name}", place or "real") for name, place in (tree.get("real") or {}).items()),
        ("virtual_time", str(bool(tree.get("virtual_time"))).lower()),
        *(("fault", spec) for spec in tree.get("faults", ())),
        *(("event", event_line(row)) for row in tree.get("events", ())),
        *((("held", tree["held"]["state"]),) if tree.get("held") else ()),
    ):
        ElementTree.SubElement(properties, "property", name=key, value=str(value))
    run = ElementTree.SubElement(suite, "testcase", classname=f"hil.{name}", name="run", time=duration)
    if broken:
        problem = tree["error"] or tree["teardown_errors"][0]
        reported = ElementTree.SubElement(run, "error", type=problem["type"], message=problem["message"])
        reported.text = printable(in_words(problem["frames"])) or None
    for row in rows:
        case = ElementTree.SubElement(
            suite, "testcase", classname=f"hil.{name}", name=str(row["name"]), time="0"
        )
        if row["outcome"] == "FAIL":
            ElementTree.SubElement(case, "failure", type="limit", message=_sentence(row))
        elif row["outcome"] == "NOT MEASURED":
            ElementTree.SubElement(case, "skipped", message="the run ended before it")
        if row.get("doubt"):
            ElementTree.SubElement(case, "system-out").text = printable(row["doubt"])
    for element in suite.iter():
        element.attrib = {key: printable(text) for key, text in element.attrib.items()}
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"


def _sentence(row: Mapping[str, Any]) -> str:
    if row["value"] is None:
        return "declared but never set, or not a number"
    limits = [f"{s} {row[k]:.12g}" for s, k in ((">=", "low"), ("<=", "high")) if row[k] is not None]
    digits = digits_apart(row["value"], (row["low"], row["high"]), least=6)
    return f"{row['value']:.{digits}g} {row['unit']}, expected {' and '.join(limits)} {row['unit']}"


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def git_revision(folder: Path) -> str | None:
    """Return the commit of the checkout of `folder`, with `+` if files differ from it; None without one."""
    try:
        head, changed = (
            subprocess.run(
                ["git", "-C", str(folder), *arguments], capture_output=True, text=True, timeout=10, check=True
            ).stdout.strip()
            for arguments in (("rev-parse", "HEAD"), ("status", "--porcelain", "--untracked-files=no"))
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return head + ("+" if changed else "")
