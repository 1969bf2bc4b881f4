"""Finds varied values that made no difference: a setting without effect has not been tested."""

from collections.abc import Mapping, Sequence
from typing import Any

from hil.campaign.table import Row
from hil.config.control import law_of


def alike(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return groups of values of a varied setting for which every run measured bit-identical values.

    Each run is compared with the run of the same seed and the same other settings.

    Returns:
        One entry per group: `key` of the setting and the `values`; none if nothing was measured.
    """
    keys = dict.fromkeys(key for row in rows for key, _ in row.case.settings)
    return [{"key": key, "values": values} for key in keys for values in _classes(key, rows)]


def _classes(key: str, rows: Sequence[Row]) -> list[list[str]]:
    """Return groups of two or more values of one setting that made no difference."""
    outcomes: dict[str, dict[Any, tuple[Any, ...]]] = {}
    for row in rows:
        settings = dict(row.case.settings)
        value = settings.pop(key)
        outcomes.setdefault(value, {})[row.case.seed, tuple(settings.items())] = _outcome(row)
    classes: list[list[str]] = []
    for value, own in outcomes.items():
        if (twins := next((c for c in classes if outcomes[c[0]] == own), None)) is not None:
            twins.append(value)
        elif any(measured for _, measured in own.values()):
            classes.append([value])
    return [values for values in classes if len(values) > 1]


def _outcome(row: Row) -> tuple[str, tuple[tuple[str, float], ...]]:
    """Return verdict and measured values of a run."""
    measured = ((n, m["value"]) for n, m in row.measurements.items() if m["value"] is not None)
    return row.verdict, tuple(measured)


def in_a_sentence(found: Mapping[str, Any]) -> str:
    """Return a sentence: `gain: 1, 2 gave the same values in every run`, and what that means."""
    why, law = "perhaps no run reached a situation in which it matters", law_of(found["key"])
    if law is not None:
        why = f"only the control law {law!r} reads it: vary it with control.law = {law!r}"
    values = ", ".join(found["values"])
    return f"{found['key']}: {values} gave the same values in every run, to the last bit; {why}"
