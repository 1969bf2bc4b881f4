"""Selects results by search words, or by name."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from hil.core.errors import UsageError, did_you_mean
from hil.report.history.index import LIVE, OURS, UNFINISHED, Kept
from hil.support.file_reading import dotted

LAST = "last"


def chosen(
    found: Sequence[Kept],
    *,
    procedure: str = "",
    bench: str = "",
    verdict: str = "",
    since: datetime | None = None,
    words: Sequence[str] = (),
    within: bool = False,
) -> list[Kept]:
    """Return the results that meet all conditions, in the given order.

    Args:
        found: all results.
        procedure: name of the procedure; empty for any.
        bench: name of the bench; empty for any.
        verdict: verdict, case-insensitive; empty for any.
        since: time of the oldest result to include.
        words: search words, case-insensitive; the text of a result must contain all of them.
        within: True to include single runs of a campaign or a commissioning.
    """
    return [
        kept
        for kept in found
        if (not procedure or kept.what == procedure)
        and (not bench or kept.bench == bench)
        and (not verdict or kept.verdict == verdict.upper())
        and (since is None or kept.when >= since)
        and (within or not kept.within)
        and all(word.casefold() in _text(kept) for word in words)
    ]


def _text(kept: Kept) -> str:
    """Return the searchable text: names, verdict, errors, notes, faults; seed and parameters as KEY=VALUE."""
    tree: Mapping[str, Any] = kept.result
    parts = [kept.name, kept.kind, kept.what, kept.bench, kept.where, kept.verdict, kept.why]
    parts += [str(kept.when), tree.get("summary", ""), *tree.get("notes", ()), *tree.get("faults", ())]
    problems = [tree.get("error"), *tree.get("teardown_errors", ())]
    parts += [f"{p['type']} {p['step']} {p['message']}" for p in problems if p]
    parts += [f"{row['name']} {row['outcome']}" for row in tree.get("measurements", ())]
    parts += [f"{key}={value}" for key, value in dotted(tree.get("parameters", {}))]
    parts += [f"seed={tree['seed']}"] if tree.get("seed") is not None else []
    parts += [f"{key} {value}" for key, value in dotted(tree.get("versions", {}))]
    if tree.get("calibration"):
        parts.append("calibration {path} version {version}".format(**tree["calibration"]))
    return "\n".join(map(str, parts)).casefold()


def named(found: Sequence[Kept], name: str, *, whole: bool = False) -> Kept:
    """Return the result with the name that a user gave.

    Args:
        found: all results, the latest first.
        name: name in `hil results list`, or the folder; unless `whole`, also a unique part of the name, or
            `last` for the latest result of `hil`, finished if there is one.
        whole: True to require the full name.

    Raises:
        UsageError: no result or several results match.
    """
    if name == LAST and not whole:
        ours = [k for k in found if k.kind in OURS and not k.within]
        latest = next((k for k in ours if k.kind not in (LIVE, UNFINISHED)), next(iter(ours), None))
        if latest is None:
            raise UsageError("there is no result yet", remedy="run a procedure first")
        return latest
    there = Path(name).resolve()
    near = [k for k in found if name and (k.name == name.rstrip("/") or k.folder.resolve() == there)]
    if not near and name and not whole:
        near = [k for k in found if name in k.name]
    if len(near) == 1:
        return near[0]
    if near:
        few = ", ".join(k.name for k in near[:4])
        raise UsageError(f"{name!r} names {len(near)} results: {few}", expected="one of them")
    hint = did_you_mean(name, [k.name for k in found]) or "see hil results list"
    raise UsageError(f"no result is called {name!r}", remedy=hint)
