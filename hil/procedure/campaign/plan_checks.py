"""Refuses a campaign with impossible or contradicting settings before it begins."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from hil.bench import planned_faults
from hil.core.errors import UsageError
from hil.procedure.campaign.cases import Case
from hil.procedure.campaign.run_case import Setup
from hil.procedure.declaration import Procedure
from hil.procedure.operator import Answers
from hil.procedure.parameters import as_dict, make_parameters


def check(setup: Setup, proc: Procedure, cases: Sequence[Case]) -> None:
    """Refuse before anything runs what no case, or a single one, could do.

    Raises:
        UsageError: a setting that is both given and varied, two values of one that mean the same, a real
            device.
        ConfigError: parameters, bench, faults or calibration that cannot be used.
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
    """What a case would run with: equal for settings that differ only in how they are written."""
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
    faults = repr(planned_faults(source.config, source.faults))
    return json.dumps([as_dict(parameters), source.config.model_dump(mode="json"), faults], sort_keys=True)
