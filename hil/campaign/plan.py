"""Checks the plan of a campaign before it starts, and keeps it in the campaign's folder.

Resuming needs the same plan, files and versions.
"""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from hil.campaign.cases import Case
from hil.campaign.input_files import contents_of
from hil.campaign.run_case import Setup
from hil.core.errors import ConfigError, UsageError, reason_of
from hil.core.result_names import PLAN, RUNS
from hil.procedure.declaration import Procedure
from hil.procedure.operator import Answers
from hil.procedure.parameters import as_dict, make_parameters
from hil.support.atomic_files import make_folder, put_whole
from hil.support.file_reading import read_json
from hil.support.folder_lock import locked
from hil.support.versions import make

SCHEMA = 1
_NOT_COMPARED = ("answers", "keep", "places")


def keep_plan(out: Path, proc: Procedure, setup: Setup, cases: Sequence[Case], *, resume: bool) -> None:
    """Write the plan of a new campaign, or compare it with the plan of the campaign to resume.

    Raises:
        ConfigError: the folder holds a campaign already, or none to resume; options or a file have changed.
    """
    shared = {key: value for key, value in vars(setup).items() if key not in _NOT_COMPARED}
    plan = json.loads(json.dumps({"schema": SCHEMA, "procedure": proc.name, **shared}))
    held = {
        "contents": contents_of(replace(setup, answers=None), proc, cases),
        "make": make(),
        "cases": [case.name for case in cases],
    }
    path = out / PLAN
    if resume:
        held = _held_against(path, plan, held)
    elif (out / RUNS).exists():
        raise ConfigError(f"{out}: holds a campaign", remedy="choose another --out, or --resume")
    try:
        put_whole(path, (json.dumps({**plan, **held}, indent=1) + "\n").encode())
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written ({reason_of(error)})") from None


@contextmanager
def locked_folder(out: Path, *, resume: bool) -> Iterator[None]:
    """Lock a folder against other campaigns, if its file system has locks; create it for a new campaign.

    Raises:
        UsageError: another campaign runs in the folder.
        ConfigError: the folder cannot be created.
    """
    try:
        if not resume:
            make_folder(out)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written ({reason_of(error)})") from None
    with locked(out, "a campaign"):
        yield


def _held_against(path: Path, plan: dict[str, Any], held: dict[str, Any]) -> dict[str, Any]:
    """Compare with the plan at `path`; return versions, cases and file contents merged from both."""
    if not path.exists():
        raise ConfigError(f"{path}: there is no campaign to resume", remedy="without its plan, start anew")
    before = read_json(path)
    if not (isinstance(before, dict) and all(isinstance(before.get(k, v), type(v)) for k, v in held.items())):
        raise ConfigError(f"{path}: is not the plan of a campaign")
    if before.get("schema") != SCHEMA:
        raise ConfigError(f"{path}: another version of the package made it", remedy="start anew")
    kept, contents = before.get("contents", {}), held["contents"]
    if left := set(before.get("cases", [])).difference(held["cases"]):
        raise ConfigError(
            f"{path}: the campaign has {len(left)} more cases, {min(left)} among them",
            remedy="give the same --seeds and --vary, or more of them",
        )
    other = [
        f"{name} {was}, now {held['make'].get(name)}"
        for name, was in before.get("make", {}).items()
        if held["make"].get(name) != was
    ]
    if other:
        raise ConfigError(
            f"{path}: the campaign was begun with {', '.join(other)}; its runs could not be compared",
            remedy="install what it was begun with, or start anew with another --out",
        )
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
    return {**held, "contents": {**kept, **contents}}


def check(setup: Setup, proc: Procedure, cases: Sequence[Case]) -> None:
    """Check all cases before anything runs.

    Raises:
        UsageError: a setting is both given and varied, two values of a setting mean the same, or a device is
            real.
        ConfigError: parameters, bench, faults or calibration of a case cannot be used.
    """
    if setup.answers is not None:
        Answers(Path(setup.answers))
    _check_given_once(setup, cases[0])
    combinations: dict[tuple[tuple[str, str], ...], Case] = {}
    for case in cases:
        combinations.setdefault(case.settings, case)
    meanings: dict[str, Case] = {}
    for case in combinations.values():
        if (other := meanings.setdefault(_meaning(setup, proc, case), case)) is not case:
            raise UsageError(
                f"--vary: {other.group} and {case.group} are the same setting",
                remedy="name each value once, however it is written",
            )


def _check_given_once(setup: Setup, case: Case) -> None:
    given = {text.partition("=")[0].strip() for text in setup.settings}
    for key, _ in case.settings:
        if key in given:
            raise UsageError(
                f"{key} is both given by --set and varied by --vary", remedy="leave one of them out"
            )


def _meaning(setup: Setup, proc: Procedure, case: Case) -> str:
    """Return the settings of a case in normal form: equal if they differ only in notation."""
    source, given = setup.source(proc, case)
    parameters = make_parameters(proc.parameters, given, proc.name)
    proc.check_needs(source.config)
    source.check_faults()
    source.describe_calibration()
    if not source.virtual:
        raise UsageError(
            f"bench {source.config.name}: {', '.join(source.real)} cannot be real in a campaign",
            expected="every device emulated",
            remedy="add --emulate all",
        )
    faults = repr(source.planned_faults())
    return json.dumps([as_dict(parameters), source.config.model_dump(mode="json"), faults], sort_keys=True)
