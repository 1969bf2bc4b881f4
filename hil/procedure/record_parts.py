"""Stores results of a procedure as a part of the robot's record, once the run has passed.

After the run each part is also written to a separate file, `part_NAME.toml`, so that a bench without a
record can apply it later (`hil robot apply RECORD --from part_camera.toml`). This file and
`bench_fragment.toml` name the robot and the verdict of the run.
"""

import hashlib
import math
from collections.abc import Mapping
from datetime import date, timedelta
from pathlib import Path
from typing import Any

import tomli_w

from hil.config.robot_record import Confirmation, Figure, NewPart, Part, RobotRecord, Spread
from hil.config.robot_record.overlay import identity, known_parts
from hil.core.cross_check import CrossCheck
from hil.core.errors import HilError
from hil.core.result_names import PASSED
from hil.procedure.bench_fragment import seal_fragment
from hil.procedure.context import Context
from hil.procedure.measurements import Verdict
from hil.support.atomic_files import write_text

__all__ = ["keep_parts", "known_parts", "leave_part"]

_PIECE = 1 << 20
_PLACE = "environment."
"""Table that says where the robot stands, which is not kept of the robot."""


def leave_part(
    ctx: Context,
    name: str,
    *,
    values: Mapping[str, Any] | None = None,
    figures: Mapping[str, Figure] | None = None,
    files: Mapping[str, Path] | None = None,
    covariance: Spread | None = None,
    surface: str = "",
) -> None:
    """Add a part for the robot's record; it is stored if the run passes. Values must be finite.

    Args:
        ctx: context of the run.
        name: name of the part (`hil.config.robot_record.PARTS`).
        values: dotted keys of the bench file -> value.
        figures: measured numbers by name.
        files: key of the bench file -> path of the file to store.
        covariance: covariance of some of the figures.
        surface: surface for which the part is valid; empty for all.
    """
    config = ctx.source.config
    part = Part(
        procedure=ctx.procedure,
        verdict="PASS",
        measured=ctx.started,
        bench=config.name,
        surface=surface,
        until=_until(ctx.started, config.record.valid_days),
        values=dict(values or {}),
        figures=dict(figures or {}),
        covariance=covariance,
    )
    ctx.findings.learned[name] = NewPart(part, dict(files or {}))


def _write_part(ctx: Context, name: str, one: NewPart, verdict: Verdict) -> None:
    """Write the part to a separate file and attach it."""
    tree = one.part.model_dump(mode="json", exclude_none=True, exclude={"files", "made_with"})
    tree["values"] |= {key: str(path.relative_to(ctx.folder)) for key, path in one.files.items()}
    robot = identity(ctx.source.config, ctx.source.seed).model_dump(mode="json", exclude_none=True)
    tree |= {"part": name, "verdict": verdict.value, "robot": robot}
    text = f"# For `hil robot apply RECORD --from` this file.\n{tomli_w.dumps(tree)}"
    ctx.attach(f"part {name} of the record", write_text(ctx.folder / f"part_{name}.toml", text))


def _until(started: str, days: int | None) -> str:
    return "" if days is None else (date.fromisoformat(started[:10]) + timedelta(days=days)).isoformat()


def keep_parts(ctx: Context, verdict: Verdict) -> tuple[dict[str, Any] | None, HilError | None]:
    """Write the parts of a run to files in its folder and, if the run passed, to the record of its bench.

    The record also keeps which keys of the bench file the run has confirmed; one that it contradicted is no
    longer confirmed, whatever its verdict.

    Returns:
        Entry of `result.json`: folder, version, names of the new parts, and of the parts that were removed
        because they depend on replaced parts; None without a record or new parts. And the error, if the
        record cannot be written: its current version then stays.
    """
    config, learned = ctx.source.config, ctx.findings.learned
    ended = verdict in (*PASSED, Verdict.FAIL)
    try:
        seal_fragment(ctx.folder, verdict.value)
        for name, one in learned.items() if ended else ():
            _write_part(ctx, name, one, verdict)
    except HilError as error:
        return None, error if ended else None
    if config.record.folder is None:
        return None, None
    passed = verdict in PASSED
    if learned and not passed:
        ctx.note(f"The record {config.record.folder} was left as it is: the run ended in {verdict.value}.")
    try:
        return _kept(ctx, verdict, learned if passed else {}), None
    except HilError as error:
        return None, error


def _kept(ctx: Context, verdict: Verdict, learned: Mapping[str, NewPart]) -> dict[str, Any] | None:
    config, granted = ctx.source.config, ctx.benches.granted.values()
    contradicted = {row.key: row.value for row in granted if row.state == "contradicted"}
    record = RobotRecord(Path(str(config.record.folder)))
    before = record.read().version if record.exists() else 0
    recordings = _digests(ctx) if learned else {}
    parts = {
        name: NewPart(
            one.part.model_copy(update={"verdict": verdict.value, "recordings": recordings}), one.files
        )
        for name, one in learned.items()
    }
    confirmed = {
        row.key: _confirmation(ctx, row)
        for row in granted
        if verdict in PASSED and row.state == "confirmed" and not row.on and not row.key.startswith(_PLACE)
    }
    if not (parts or contradicted or confirmed):
        return None
    gone = record.add(
        parts,
        identity(config, ctx.source.seed),
        created=ctx.started,
        why=ctx.procedure,
        confirmed=confirmed,
        contradicted=contradicted,
    )
    version = record.read().version
    if version == before:
        return None
    words = f"; without {', '.join(gone)}, measured on top of what changed" if gone else ""
    new = ", ".join(parts) or "what was confirmed"
    ctx.note(f"{record.folder} is now version {version}, with {new} of this run{words}.")
    return {"folder": str(record.folder), "version": version, "parts": list(parts), "gone": list(gone)}


def _confirmation(ctx: Context, row: CrossCheck) -> Confirmation:
    off, within = (v if math.isfinite(v) else None for v in (row.difference, row.within))
    return Confirmation(
        value=row.value,
        by=row.by,
        procedure=ctx.procedure,
        measured=ctx.started,
        difference=off,
        within=within,
        unit=row.unit,
    )


def _digests(ctx: Context) -> dict[str, str]:
    found = {}
    for name in ctx.findings.recordings:
        path = ctx.folder / name
        if path.is_file():
            digest = hashlib.sha256()
            with path.open("rb") as file:
                while piece := file.read(_PIECE):
                    digest.update(piece)
            found[name] = digest.hexdigest()
    return found
