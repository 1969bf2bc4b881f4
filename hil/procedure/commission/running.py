"""Runs a commissioning: one procedure after the other, each with what the record knows by then.

A procedure that passes puts its part into the record; the first that does not ends the commissioning with
what to do. The same code runs in virtual time, at the wire and on the real robot.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hil.config.bench import BenchConfig
from hil.config.encoders import EncodersConfig
from hil.procedure.bench_source import BenchSource
from hil.procedure.commission.stages import PROMPTS, STAGES, Place, Stage, placed, stages
from hil.procedure.commission.state import PASSED, State, state_of
from hil.procedure.fragment import NAME as FRAGMENT
from hil.procedure.interrupts import Interrupts
from hil.procedure.journal import NAME as JOURNAL
from hil.procedure.measurements import Verdict
from hil.procedure.operator import Operator, Terminal, go_ahead
from hil.procedure.results import RESULT, Result
from hil.procedure.runner import RunOptions, run_procedure
from hil.report.commission_page import write_commission_page
from hil.report.run_page import write_run_page
from hil.vocabulary.clock import Clock
from hil.vocabulary.errors import ConfigError, HilError
from hil.vocabulary.files import check_folder
from hil.vocabulary.progress import WHOLE, Report, silent
from hil.vocabulary.reading import dotted, read_json, read_toml

RECORD = "robot"


@dataclass(frozen=True)
class Commission:
    """What to commission and how.

    Attributes:
        source: bench of the wall. Where it names no record, one is made in `folder`.
        folder: of the results.
        clock: for durations.
        now: date and time, ISO 8601.
        quick: the short form of every procedure.
        resume: go on with an interrupted one.
        operator: who answers prompts.
        report: progress.
        interrupts: signals.
        order: what is run.
    """

    source: BenchSource
    folder: Path
    clock: Clock
    now: Callable[[], str]
    quick: bool = False
    resume: bool = False
    operator: Operator = field(default_factory=Terminal)
    report: Report = silent
    interrupts: Interrupts = field(default_factory=Interrupts)
    order: tuple[Stage, ...] = STAGES

    def options(self) -> dict[str, Any]:
        """What a resumed one must have alike."""
        source = self.source
        return {"bench": str(source.bench), "emulate": source.emulate, "seed": source.seed,
                "quick": self.quick, "realtime": source.realtime, "faults": list(source.faults),
                "settings": json.loads(json.dumps(dict(source.overrides)))}  # fmt: skip


def commission(asked: Commission) -> tuple[dict[str, Any], int]:
    """Run all procedures, up to the first that does not pass.

    Args:
        asked: what and how.

    Returns:
        JSON values (`verdict`, `robot`, `procedures`, `wall`, `page`, `stopped`), and the exit code.

    Raises:
        HilError: something was wrong before anything could move.
    """
    check_folder(asked.folder)
    state = state_of(asked.folder, asked.options(), resume=asked.resume)
    config = asked.source.config
    record = Path(config.record.folder) if config.record.folder else (asked.folder / RECORD).resolve()
    source = asked.source.changed(overrides={"record.folder": str(record)})
    source.check_faults()
    _check_all(asked, source, config)
    run = _Running(replace(asked, source=source), state, config)
    code, stopped = run.all()
    told = summary(state, record, stopped)
    page = write_commission_page(asked.folder, told, source.config.name, asked.now(), asked.source.seed)
    return told | {"page": str(page)}, code


def _check_all(asked: Commission, source: BenchSource, config: BenchConfig) -> None:
    """Every bench that will be needed can be configured, before anything moves."""
    for number, (stage, why) in enumerate(stages(config, asked.order), start=1):
        if not why:
            stage.procedure.check_needs(source.changed(overrides=placed(stage, number, config)).config)


def summary(state: State, record: Path, stopped: dict[str, Any] | None) -> dict[str, Any]:
    """The result as `hil commission --json` prints it; keys may be added, never renamed."""
    verdicts = {name: entry["verdict"] for name, entry in state.done.items()}
    order = [v.value for v in Verdict]
    judged = [v for v in verdicts.values() if v in order]
    verdict = max(judged, key=order.index) if judged else Verdict.ABORTED.value
    if stopped is not None and verdict in PASSED:
        verdict = Verdict.ABORTED.value
    return {
        "verdict": verdict,
        "robot": str(record),
        "procedures": verdicts,
        "wall": state.done.get("wall_ablation", {}).get("wall", {}),
        "stopped": stopped,
        "stages": [{"name": name, **entry} for name, entry in state.done.items()],
        "folder": str(state.folder),
    }


class _Running:
    """The stages of one commissioning, one after the other."""

    def __init__(self, asked: Commission, state: State, config: BenchConfig) -> None:
        self._asked, self._state, self._config = asked, state, config
        self._place: Place | None = None
        every = list(stages(config, asked.order))
        self._stages = every
        self._total = sum(stage.weight for stage, why in every if not why)
        self._before = 0.0

    def all(self) -> tuple[int, dict[str, Any] | None]:
        """Exit code, and where and why it stopped (None at the end)."""
        for number, (stage, why) in enumerate(self._stages, start=1):
            if why:
                self._state.keep(stage.name, verdict="SKIPPED", why=why)
                continue
            if not self._state.passed(stage.name):
                result = self._one(stage, number)
                if result.verdict.value not in PASSED:
                    return result.exit_code, self._stopped(stage, result)
            self._before += stage.weight
            self._tell(0.0)
        return 0, None

    def _one(self, stage: Stage, number: int) -> Result:
        self._moved_to(stage.place)
        result = self._run(stage, number, {})
        if stage.name == "bring_up" and result.verdict is Verdict.FAIL:
            signs = found_signs(result.folder, self._config)
            if signs:
                self._asked.report("bring_up again, with the signs that it found", 0, 1)
                result = self._run(stage, number, signs)
        facts: dict[str, Any] = {"verdict": result.verdict.value, "folder": result.folder.name}
        if "wall" in result.facts["data"]:
            facts["wall"] = result.facts["data"]["wall"]
        self._state.keep(stage.name, **facts, seconds=result.facts["duration_s"])
        return result

    def _moved_to(self, place: Place) -> None:
        """Have a person move a real robot to where the next procedures need it."""
        if self._place != place and self._asked.source.real:
            with self._asked.interrupts.heeded():
                go_ahead(self._asked.operator, PROMPTS[place])
        self._place = place

    def _run(self, stage: Stage, number: int, overrides: dict[str, object]) -> Result:
        asked = self._asked
        folder, resume = self._folder(stage, number)
        source = asked.source.changed(overrides={**placed(stage, number, self._config), **overrides})
        options = RunOptions(
            folder=folder, clock=asked.clock, started=asked.now(),
            parameters=stage.parameters(asked.quick, source.config), operator=asked.operator,
            report=self._within(stage), resume=resume, interrupts=asked.interrupts,
        )  # fmt: skip
        result = run_procedure(stage.procedure, source, options)
        write_run_page(result.folder)
        return result

    def _folder(self, stage: Stage, number: int) -> tuple[Path, bool]:
        """Where the stage's results go, and whether an interrupted run of it is there."""
        base = self._asked.folder / f"{number:02d}_{stage.name}"
        tries = [base, *(base.with_name(f"{base.name}-{k}") for k in range(2, 100))]
        for path in tries:
            if not (path / JOURNAL).exists() and not (path / RESULT).exists():
                return path, False
            if self._asked.resume and _unfinished(path):
                return path, True
        raise ConfigError(f"{base}: tried a hundred times", remedy="start anew with another --out")

    def _within(self, stage: Stage) -> Report:
        """Progress of a stage as a part of the whole."""

        def report(what: str, done: int, total: int) -> None:
            if what == WHOLE:
                self._tell(stage.weight * done / max(total, 1))
            else:
                self._asked.report(f"{stage.name.replace('_', ' ')}: {what}", done, total)

        return report

    def _tell(self, within: float) -> None:
        self._asked.report(WHOLE, round(self._before + within), round(self._total))

    def _stopped(self, stage: Stage, result: Result) -> dict[str, Any]:
        """Where it stopped, why, and what to do."""
        why = result.error.message if result.error is not None else missed(result.measurements)
        again = f"hil commission --resume --out {self._asked.folder}"
        first = f"look at {result.folder / 'report.html'} and mend what it names; then "
        return {
            "procedure": stage.name,
            "verdict": result.verdict.value,
            "why": why,
            "report": str(result.folder / "report.html"),
            "do": f"{'' if result.verdict is Verdict.ABORTED else first}{again}, with the other options as "
            "before. What was found up to here is in the record and stays.",
        }


def missed(measurements: Sequence[Mapping[str, Any]]) -> str:
    """What failed, in words: what lies beyond its limits, then what was not measured because of it."""
    failed = [row for row in measurements if row["outcome"] == "FAIL"]
    beyond, absent = (
        [str(r["name"]) for r in failed if (r["value"] is None) == gone] for gone in (False, True)
    )
    parts = (("beyond their limits", beyond), ("not measured", absent))
    return "; ".join(f"{what}: {', '.join(names)}" for what, names in parts if names)


def _unfinished(folder: Path) -> bool:
    """Whether a run was struck down or aborted in a folder."""
    if not (folder / RESULT).exists():
        return (folder / JOURNAL).exists()
    tree = read_json(folder / RESULT)
    return isinstance(tree, dict) and tree.get("verdict") in ("ABORTED", "ERROR")


def found_signs(folder: Path, config: BenchConfig) -> dict[str, object]:
    """Signs that a failed bring-up found otherwise than configured, as overrides; empty without any."""
    path = folder / FRAGMENT
    if not path.exists():
        return {}
    encoders = config.of(EncodersConfig)
    believed = {
        "alignment.drive_sign": config.alignment.drive_sign,
        "alignment.steer_sign": config.alignment.steer_sign,
        **({} if encoders is None else {"encoders.sign": encoders.sign}),
    }  # fmt: skip
    try:
        tree = read_toml(path)
    except HilError:
        return {}
    found = dict(dotted(tree))
    other = {key: found[key] for key in believed if key in found and list(found[key]) != list(believed[key])}
    return found if other else {}
