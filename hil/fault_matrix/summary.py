"""Summarises a fault campaign as JSON data for its pages: fault classes with bounds, rows, failures."""

from collections.abc import Mapping, Sequence
from typing import Any

from hil.core.event_rows import without_numbers
from hil.fault_matrix.cases import MOMENTS
from hil.fault_matrix.judge import CellVerdict
from hil.fault_matrix.movement_bounds import CLASSES, FaultClass, class_of, kind_of

UNNOTICED = "no sensor notices"
_AT_THE_END = "begins at the end of the climb: the run was over before it could be detected"
_LOST = "single messages are lost or fail their check, and the next ones hold the same data"
_OF_ANY: Mapping[str, str] = {
    "duplicate": "duplicate samples count once",
    "drop": _LOST,
    "truncate": _LOST,
    "corrupt": _LOST,
    "pieces": "the pieces are put together again",
    "slow": "a stream is checked once a second: reported within two seconds in a longer run",
}
"""Explanation by fault, for device kinds without their own (`DeviceKind.silent_faults`)."""


def why_quiet(device: str, fault: str, moments: Sequence[str] = ("motion",)) -> str:
    """Return why a fault was not reported at these moments."""
    if list(moments) == ["stop"]:
        return _AT_THE_END
    passes = kind_of(device).silent_faults
    return passes.get(fault) or passes.get("*") or _OF_ANY.get(fault, UNNOTICED)


def quiet_rows(verdicts: Sequence[CellVerdict]) -> list[dict[str, Any]]:
    """Return a row for each fault that was not reported: `device`, `fault`, `moments` and `why`."""
    cells = [v.cell for v in verdicts if not v.reported and not v.why and len(v.cell.specs) == 1]
    found: dict[tuple[str, str], list[str]] = {}
    for cell in cells:
        moments = found.setdefault((cell.device, cell.what), [])
        moments += [cell.moment] if cell.moment not in moments else []
    return [
        {
            "device": device,
            "fault": fault,
            "moments": moments,
            "why": why_quiet(device, fault.partition(",")[0], moments),
        }
        for (device, fault), moments in found.items()
    ]


def told_rows(verdicts: Sequence[CellVerdict]) -> list[dict[str, Any]]:
    """Return what the bench told of each fault: `device`, `fault` and `lines`, of like ones the first."""
    found: dict[tuple[str, str], dict[str, str]] = {}
    for v in verdicts:
        lines = found.setdefault((v.cell.device, v.cell.fault), {})
        for line in v.told:
            lines.setdefault(without_numbers(line), f"{v.cell.moment}: {line}")
    return [{"device": d, "fault": f, "lines": list(lines.values())} for (d, f), lines in found.items()]


def summary(verdicts: Sequence[CellVerdict], *, bench: str, command: str, planned: int) -> dict[str, Any]:
    """Return all data of the page.

    Args:
        verdicts: verdicts in the order of the pages.
        bench: name or file of the bench.
        command: command that repeats the campaign.
        planned: number of cells of the campaign; with fewer verdicts it was ended early.

    Returns:
        `verdict`, `bench`, `command`, `cells`, `planned`, `quiet_cells`, `classes`, `plants` with rows by
        device and fault, `failed`, `quiet`, `told`; a JSON object.
    """
    failed = [v for v in verdicts if v.why]
    return {
        "verdict": "ABORTED" if len(verdicts) < planned else "FAIL" if failed else "PASS",
        "bench": bench,
        "command": command,
        "cells": len(verdicts),
        "planned": planned,
        "quiet_cells": sum(not v.reported and not v.why for v in verdicts),
        "classes": [found for one in CLASSES if (found := _class(one, verdicts))],
        "plants": [
            _plant(plant, [v for v in verdicts if v.cell.plant == plant])
            for plant in dict.fromkeys(v.cell.plant for v in verdicts)
        ],
        "failed": [{"cell": v.cell.name, "why": "; ".join(v.why)} for v in failed],
        "told": told_rows(verdicts),
        "quiet": quiet_rows(verdicts),
    }


def _class(one: FaultClass, verdicts: Sequence[CellVerdict]) -> dict[str, Any] | None:
    """Return a class of faults with its bounds and the worst measured values; None without a cell."""
    mine = [v for v in verdicts if class_of(v.cell) is one]
    if not mine:
        return None
    return {
        "name": one.name,
        "promise": one.promise,
        "cells": len(mine),
        "failed": sum(bool(v.why) for v in mine),
        "measured": measured_in_words(mine),
    }


def _plant(plant: str, verdicts: Sequence[CellVerdict]) -> dict[str, Any]:
    moments = [m for m in (*MOMENTS, "random") if any(v.cell.moment == m for v in verdicts)]
    rows = []
    for device, fault in dict.fromkeys((v.cell.device, v.cell.what) for v in verdicts):
        mine = [v for v in verdicts if (v.cell.device, v.cell.what) == (device, fault)]
        marks = [_mark([v for v in mine if v.cell.moment == m]) for m in moments]
        rows.append(
            {
                "device": device,
                "fault": fault,
                "marks": marks,
                "measured": measured_in_words(mine),
                "failed": any(v.why for v in mine),
            }
        )
    seeds = sorted({v.cell.seed for v in verdicts})
    return {"plant": plant, "seeds": seeds, "moments": moments, "rows": rows}


def _mark(verdicts: Sequence[CellVerdict]) -> str:
    """Return the text of a table cell, which summarises all its seeds."""
    if not verdicts:
        return ""
    bad = sum(bool(v.why) for v in verdicts)
    if bad:
        return f"FAILED {bad}/{len(verdicts)}"
    ends = sorted({"on" if v.ended == "went on" else "stop" if v.opened else "none" for v in verdicts})
    return "/".join(ends) + ("" if all(v.reported for v in verdicts) else " *")


def measured_in_words(verdicts: Sequence[CellVerdict]) -> str:
    """Return how the robot was left in these cells, with the worst measured values."""
    many, fell = len(verdicts), [v for v in verdicts if v.measured.fell]
    stood = [v for v in verdicts if not v.measured.fell]
    held = [v for v in stood if v.held == "HELD"]
    reported = []
    if fell:
        reported.append(f"fell{_of(len(fell), many)}")
    if held:
        moved_mm, crept_mm = (
            1e3 * max(values)
            for values in zip(*((v.measured.moved_m, v.measured.crept_m) for v in held), strict=True)
        )
        reported.append(f"HELD{_of(len(held), many)}: moved {moved_mm:.1f} mm, then {crept_mm:.1f} mm")
    for label, opened in (("NOT HELD", True), ("the bench did not open", False)):
        lost = [v for v in stood if v.held != "HELD" and v.opened is opened]
        if lost:
            worst = max(lost, key=lambda v: v.measured.moved_m).measured
            bound = f"moved {1e3 * worst.moved_m:.1f} mm of {1e3 * worst.most_m:.1f}"
            reported.append(f"{label}{_of(len(lost), many)}: {bound}")
    others = sorted({name for v in verdicts for name in v.others})
    return "; ".join([*reported, *([f"also named: {', '.join(others)}"] if others else [])])


def _of(part: int, whole: int) -> str:
    return "" if part == whole else f" in {part} of {whole}"
