"""Runs a commissioning: one procedure after the other, each with the current record of the robot.

A procedure that passes adds its part to the record. The first procedure that does not pass ends the
commissioning with a remedy. The same code runs in virtual time, at wire level and on the real robot.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hil.bench.cross_checks.parameters import Parameters
from hil.commission.reruns import as_its_file_says, dependencies_of, parts_in, reason_to_repeat
from hil.commission.saved_state import DONE, State, state_of
from hil.commission.stages import PROMPTS, STAGES, Place, Stage, placed, stages
from hil.commission.stop_reason import page_of, stopped_at, stopped_before
from hil.config.bench import BenchConfig
from hil.config.encoders import EncodersConfig
from hil.config.robot_record import Part
from hil.core.clock import Clock
from hil.core.errors import EXIT_ABORTED, Aborted, ConfigError, DataError, HilError
from hil.core.result_names import JOURNAL, PASSED, RESULT
from hil.procedure.bench_fragment import NAME as FRAGMENT
from hil.procedure.bench_source import BenchSource
from hil.procedure.interrupts import Interrupts
from hil.procedure.measurements import Verdict
from hil.procedure.operator import Operator, Terminal, go_ahead
from hil.procedure.parameters import make_parameters
from hil.procedure.run_journal import differences, read_journal
from hil.procedure.run_result import Result
from hil.procedure.runner import RunOptions, header_of, run_procedure
from hil.report.commission_page import write_commission_page
from hil.support.atomic_files import check_folder, make_folder
from hil.support.file_reading import dotted, read_json, read_toml
from hil.support.folder_lock import locked
from hil.support.progress import WHOLE, Report, silent

RECORD = "robot"


@dataclass(frozen=True)
class Commission:
    """Bench and options of a commissioning.

    Attributes:
        source: the wall bench. If it names no record, a record is created in `folder`.
        folder: results folder.
        clock: clock for durations.
        now: date and time, ISO 8601.
        quick: True to run the short form of every procedure.
        resume: True to resume an interrupted commissioning.
        operator: operator that answers prompts.
        report: progress.
        interrupts: signals.
        order: the stages to run.
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
        """Return the options that a resumed commissioning must share."""
        source = self.source
        return {
            "bench": str(source.bench),
            "emulate": source.emulate,
            "seed": source.seed,
            "quick": self.quick,
            "realtime": source.realtime,
            "faults": list(map(str, source.faults)),
            "settings": json.loads(json.dumps(dict(source.overrides))),
        }


def commission(asked: Commission) -> tuple[dict[str, Any], int]:
    """Run all procedures up to the first that does not pass.

    Args:
        asked: bench and options.

    Returns:
        JSON values (`verdict`, `robot`, `procedures`, `wall`, `page`, `stopped`), and the exit code.

    Raises:
        HilError: something was wrong before anything could move.
    """
    check_folder(asked.folder)
    if not asked.resume:
        make_folder(asked.folder)
    with locked(asked.folder, "a commissioning"):
        return _commissioned(asked)


def _commissioned(asked: Commission) -> tuple[dict[str, Any], int]:
    """As `commission`, in its locked folder."""
    state = state_of(asked.folder, asked.options(), resume=asked.resume)
    config = asked.source.config
    record = Path(config.record.folder) if config.record.folder else (asked.folder / RECORD).resolve()
    source = asked.source.changed(overrides={"record.folder": str(record)})
    source.check_faults()
    _check_all(asked, source, config)
    run = _Running(replace(asked, source=source), state, config)
    code, stopped = run.all()
    reported = summary(state, record, stopped) | {"parameters": taken_for_granted(source)}
    try:
        page = write_commission_page(
            asked.folder, reported, source.config.name, asked.now(), asked.source.seed
        )
    except HilError:
        return reported | {"page": None}, code or EXIT_ABORTED
    return reported | {"page": str(page)}, code


def _check_all(asked: Commission, source: BenchSource, config: BenchConfig) -> None:
    """Check, before anything moves, that every needed bench can be configured."""
    for number, (stage, why) in enumerate(stages(config, asked.order), start=1):
        if not why:
            stage.procedure.check_needs(source.changed(overrides=placed(stage, number, config)).config)


def summary(state: State, record: Path, stopped: dict[str, Any] | None) -> dict[str, Any]:
    """Return the result that `hil commission --json` prints; keys may be added, never renamed."""
    verdicts = {name: entry["verdict"] for name, entry in state.done.items()}
    order = [v.value for v in Verdict]
    judged = [v for v in verdicts.values() if v in order]
    verdict = max(judged, key=order.index) if judged else Verdict.ABORTED.value
    if stopped is not None and verdict in DONE:
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


def taken_for_granted(source: BenchSource) -> list[dict[str, Any]]:
    """Return what the record confirms of the bench file, and what nothing has confirmed, as JSON values.

    Args:
        source: bench with the record; nothing is returned where it cannot be configured.
    """
    try:
        return [row.to_json() for row in Parameters(source.changed().config).rows()]
    except ConfigError:
        return []


class _Running:
    """Runs the stages of one commissioning, one after the other."""

    def __init__(self, asked: Commission, state: State, config: BenchConfig) -> None:
        self._request, self._state, self._config = asked, state, config
        self._record = Path(str(asked.source.overrides["record.folder"]))
        self._as_its_file_says = as_its_file_says(asked.source)
        self._again: dict[str, str] = {}
        self._ran: list[str] = []
        self._place: Place | None = None
        every = list(stages(config, asked.order))
        self._stages = every
        self._total = sum(stage.weight for stage, why in every if not why)
        self._before = 0.0

    def all(self) -> tuple[int, dict[str, Any] | None]:
        """Run all stages; return the exit code, and where and why it stopped (None if it reached the end)."""
        self._forget_what_does_not_hold()
        for number, (stage, why) in enumerate(self._stages, start=1):
            try:
                stopped = self._next(stage, number, why)
            except HilError as error:
                if not (self._ran or isinstance(error, (Aborted, DataError))):
                    raise
                code = EXIT_ABORTED if isinstance(error, DataError) else error.exit_code
                return code, stopped_before(stage.name, error, self._request.folder)
            if stopped is not None:
                return stopped
            if not why:
                self._before += stage.weight
                self._tell(0.0)
        return 0, None

    def _forget_what_does_not_hold(self) -> None:
        """Before anything moves, mark and report the passed procedures that have to be repeated."""
        parts = parts_in(self._record)
        for stage, _ in self._stages:
            self._holds(stage, parts)

    def _holds(self, stage: Stage, parts: Mapping[str, Part]) -> bool:
        """Whether a procedure has passed and none of its dependencies has changed."""
        if not self._state.passed(stage.name):
            return False
        before = self._state.rests_on[stage.name]
        why = reason_to_repeat(stage, before, self._as_its_file_says, parts)
        found_anew = list(dict.fromkeys((*self._again, *self._ran)))
        if not why and found_anew and stage is self._stages[-1][0]:
            why = f"it shows what was found, and {', '.join(found_anew)} is repeated"
        if why:
            self._again[stage.name] = why
            self._state.forget(stage.name)
            self._request.report(f"{stage.name} again: {why}", 0, 1)
        return not why

    def _next(self, stage: Stage, number: int, why: str) -> tuple[int, dict[str, Any]] | None:
        """Run one procedure unless it has passed; if it does not pass, return exit code and reason."""
        if why:
            self._state.keep(stage.name, verdict="SKIPPED", why=why)
        elif not self._holds(stage, parts_in(self._record)):
            result = self._one(stage, number)
            if result.verdict.value not in DONE:
                return result.exit_code, stopped_at(result, self._request.folder)
        return None

    def _one(self, stage: Stage, number: int) -> Result:
        self._moved_to(stage.place)
        self._ran.append(stage.name)
        result = self._run(stage, number, {})
        if stage.name == "bring_up" and result.verdict is Verdict.FAIL:
            signs = found_signs(result.folder, self._config)
            if signs:
                self._request.report("bring_up again, with the signs that it found", 0, 1)
                result = self._run(stage, number, signs)
        facts: dict[str, Any] = {"verdict": result.verdict.value, "folder": result.folder.name}
        if "wall" in result.facts["data"]:
            facts["wall"] = result.facts["data"]["wall"]
        if stage.name in self._again:
            facts["why"] = f"repeated: {self._again[stage.name]}"
        if result.verdict.value in PASSED:
            found = parts_in(self._record)
            facts["rests_on"] = dependencies_of(self._as_its_file_says, found, result.facts["record"])
        try:
            self._state.keep(stage.name, **facts, seconds=result.facts["duration_s"])
        except DataError:
            if result.verdict.value in DONE:
                raise
        return result

    def _moved_to(self, place: Place) -> None:
        """Ask the operator to move a real robot to the place that the next procedures need."""
        if self._place != place and self._request.source.real:
            with self._request.interrupts.interruptible():
                go_ahead(self._request.operator, PROMPTS[place])
        self._place = place

    def _run(self, stage: Stage, number: int, overrides: dict[str, object]) -> Result:
        asked = self._request
        overrides = {**placed(stage, number, self._config), **overrides}
        source = asked.source.changed(overrides=overrides).with_its_faults()
        parameters = stage.parameters(asked.quick)
        folder, resume = self._folder(stage, number, source, parameters)
        options = RunOptions(
            folder=folder,
            clock=asked.clock,
            started=asked.now(),
            parameters=parameters,
            operator=asked.operator,
            report=self._within(stage),
            resume=resume,
            interrupts=asked.interrupts,
        )
        result = run_procedure(stage.procedure, source, options)
        page_of(result)
        return result

    def _folder(
        self, stage: Stage, number: int, source: BenchSource, parameters: Mapping[str, Any]
    ) -> tuple[Path, bool]:
        """Return the results folder of a stage, and whether it holds an interrupted run of this stage."""
        base = self._request.folder / f"{number:02d}_{stage.name}"
        tries = [base, *(base.with_name(f"{base.name}-{k}") for k in range(2, 100))]
        for path in tries:
            if not (path / JOURNAL).exists() and not (path / RESULT).exists():
                return path, False
            if self._request.resume and _unfinished(path, stage, source, parameters):
                return path, True
        raise ConfigError(f"{base}: tried a hundred times", remedy="start anew with another --out")

    def _within(self, stage: Stage) -> Report:
        """Return a callback that reports progress of a stage as a share of the whole commissioning."""

        def report(what: str, done: int, total: int) -> None:
            if what == WHOLE:
                self._tell(stage.weight * done / max(total, 1))
            else:
                self._request.report(f"{stage.name.replace('_', ' ')}: {what}", done, total)

        return report

    def _tell(self, within: float) -> None:
        self._request.report(WHOLE, round(self._before + within), round(self._total))


def _unfinished(folder: Path, stage: Stage, source: BenchSource, parameters: Mapping[str, Any]) -> bool:
    """Whether a folder holds a killed or aborted run of the same script and bench, which can be resumed."""
    if (folder / RESULT).exists():
        tree = read_json(folder / RESULT)
        if not isinstance(tree, dict) or tree.get("verdict") not in ("ABORTED", "ERROR"):
            return False
    if not (folder / JOURNAL).exists():
        return False
    proc, config = stage.procedure, source.config
    typed = make_parameters(proc.parameters, parameters, proc.name)
    header = header_of(proc, typed, proc.declared(typed, config), source)
    return not differences(read_journal(folder / JOURNAL).header, header, config)


def found_signs(folder: Path, config: BenchConfig) -> dict[str, object]:
    """Return the signs found by a failed bring-up as overrides; empty if none differs from the bench file."""
    path = folder / FRAGMENT
    if not path.exists():
        return {}
    encoders = config.of(EncodersConfig)
    signs = {
        "alignment.drive_sign": config.alignment.drive_sign,
        "alignment.steer_sign": config.alignment.steer_sign,
        **({} if encoders is None else {"encoders.sign": encoders.sign}),
    }
    try:
        tree = read_toml(path)
    except HilError:
        return {}
    found = dict(dotted(tree))
    other = {key: found[key] for key in signs if key in found and list(found[key]) != list(signs[key])}
    return found if other else {}
