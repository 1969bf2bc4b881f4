"""The plan of a campaign, in its folder: who goes on with it must mean the same, down to its files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.cli.campaign_files import contents_of
from hil.cli.campaign_runs import Setup
from hil.vocabulary.errors import ConfigError
from hil.vocabulary.files import make_folder, put_whole
from hil.vocabulary.reading import read_json

if TYPE_CHECKING:
    from hil.procedure.campaign import Case
    from hil.procedure.declaration import Procedure

SCHEMA = 1
PLAN, RUNS = "plan.json", "runs"
_NOT_COMPARED = ("answers", "keep", "places")


def keep_plan(out: Path, proc: Procedure, setup: Setup, cases: Sequence[Case], *, resume: bool) -> None:
    """Write the plan of a new campaign, or hold it against that of the one to go on with.

    Raises:
        ConfigError: there is a campaign, or none to go on with; other options, or a file that has changed.
    """
    shared = {key: value for key, value in vars(setup).items() if key not in _NOT_COMPARED}
    plan = json.loads(json.dumps({"schema": SCHEMA, "procedure": proc.name, **shared}))
    contents = contents_of(replace(setup, answers=None), proc, cases)
    path = out / PLAN
    if resume:
        contents = _held_against(path, plan, contents)
    elif (out / RUNS).exists():
        raise ConfigError(f"{out}: holds a campaign", remedy="choose another --out, or --resume")
    try:
        make_folder(out)
        put_whole(path, (json.dumps({**plan, "contents": contents}, indent=1) + "\n").encode())
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written ({error.strerror})") from None


def _held_against(path: Path, plan: dict[str, Any], contents: dict[str, str]) -> dict[str, str]:
    """Contents of the files of both, once the plan there is this one."""
    if not path.exists():
        raise ConfigError(f"{path}: there is no campaign to resume", remedy="without its plan, start anew")
    before = read_json(path)
    kept = before.get("contents", {}) if isinstance(before, dict) else None
    if not isinstance(kept, dict):
        raise ConfigError(f"{path}: is not the plan of a campaign")
    different = [key for key in plan if before.get(key) != plan[key]]
    if different:
        raise ConfigError(
            f"{path}: the campaign differs in {', '.join(different)}",
            remedy="resume with the same options (--seeds and --vary may grow), or start anew",
        )
    changed = [name for name, held in contents.items() if kept.get(name, held) != held]
    if changed:
        raise ConfigError(
            f"{path}: {', '.join(changed)} changed since the campaign began; its runs could not be compared",
            remedy="take back the change, or start anew with another --out",
        )
    return {**kept, **contents}
