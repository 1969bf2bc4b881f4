"""Acceptance: whether a bench is as its file says and fulfils the device contract.

Stages: doctor, the contract of every device, the age of the samples. Then, if a person confirms that the
robot is on a stand, the contract of the servos with turning wheels, and their delays. Emulated and real
devices go through the same stages. The findings are kept even when the acceptance ends early.
"""

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from hil.bench import Bench
from hil.bench.contract import (
    AT_REST,
    IN_MOTION,
    Subject,
    delays_at_rest,
    delays_in_motion,
    judged,
    punctuality,
    without_restart,
)
from hil.bench.doctor.degraded_bench import open_degraded
from hil.bench.doctor.examination import examine
from hil.commission.stages import off_the_wall
from hil.core.errors import EXIT_ABORTED, EXIT_DEVICE, EXIT_LIMIT_FAILED, EXIT_PASS, Aborted, HilError
from hil.core.finding import Finding
from hil.procedure.bench_source import BenchSource
from hil.procedure.interrupts import Interrupts
from hil.procedure.measurements import Verdict
from hil.procedure.operator import Operator, Terminal
from hil.support.progress import Report, silent
from hil.support.versions import versions

DOCTOR, CONTRACT, LATENCY, MOTION = "doctor", "contract", "latency", "motion"
TITLES = {
    DOCTOR: "The machine and every device by itself",
    CONTRACT: "What every device promises, without motion",
    LATENCY: "How old the samples are",
    MOTION: "With turning wheels, on a stand",
}
QUESTION = "is the robot on a stand, all four wheels free, and no fingers near them? (yes/no)"


@dataclass
class Stage:
    """One part of an acceptance: its findings, and its verdict once it has ended."""

    name: str
    verdict: str = Verdict.ABORTED.value
    why: str = "not begun"
    findings: list[Finding] = field(default_factory=list)

    def end(self, verdict: Verdict | None = None, why: str = "", left_out: str = "") -> None:
        """Set the verdict: the given one, else FAIL (a check failed), ABORTED (one was left out) or PASS."""
        failed = sum(f.level == "failure" for f in self.findings)
        why = why or (f"{failed} of {len(self.findings)} checks failed" if failed else "")
        self.why = "; ".join(filter(None, (why, left_out)))
        whole = Verdict.ABORTED if left_out else Verdict.PASS
        self.verdict = (verdict or (Verdict.FAIL if failed else whole)).value

    def to_json(self) -> dict[str, Any]:
        """Return the stage as a JSON object."""
        findings = [f.to_json() for f in self.findings]
        return {
            "name": self.name,
            "title": TITLES[self.name],
            "verdict": self.verdict,
            "why": self.why,
            "findings": findings,
        }


@dataclass(frozen=True)
class Acceptance:
    """Bench and options of an acceptance.

    Attributes:
        source: the bench.
        now: date and time, ISO 8601.
        on_stand: True if the operator has said that the wheels are free; otherwise the operator is asked.
        operator: operator that answers questions.
        report: progress.
        interrupts: signals.
        watch_s: time for which the doctor reads each device.
    """

    source: BenchSource
    now: Callable[[], str]
    on_stand: bool = False
    operator: Operator = field(default_factory=Terminal)
    report: Report = silent
    interrupts: Interrupts = field(default_factory=Interrupts)
    watch_s: float = 2.0


def accept(asked: Acceptance) -> tuple[dict[str, Any], int]:
    """Run all stages. The wheels turn only if no earlier stage failed and a person has allowed it.

    Args:
        asked: the bench and the options.

    Returns:
        JSON values (`verdict`, `bench`, `stages`, `devices`, `files`, ...), and the exit code.

    Raises:
        ConfigError, UsageError: the bench file or a fault is wrong; no device was opened.
    """
    config = asked.source.config
    asked.source.check_faults()
    began = asked.now()
    run = _Running(asked)
    ended_by = ""
    try:
        run.all()
    except Aborted as aborted:
        ended_by = aborted.message
        run.current.end(Verdict.ABORTED, aborted.message)
    reported = {
        "verdict": run.verdict().value,
        "bench": config.name,
        "robot": config.robot.name,
        "began": began,
        "ended": asked.now(),
        "time": "virtual time" if asked.source.virtual else "real time",
        "seed": asked.source.seed,
        "faults": list(map(str, asked.source.faults)),
        "stopped": ended_by,
        "devices": run.devices(),
        "files": list(_files(asked.source)),
        "versions": versions(),
        "held": run.held,
        "stages": [stage.to_json() for stage in run.stages.values()],
    }
    return reported, run.exit_code()


class _Running:
    """Runs the stages of one acceptance, one after the other."""

    def __init__(self, asked: Acceptance) -> None:
        self._request, self._config = asked, asked.source.config
        self.stages = {name: Stage(name) for name in TITLES}
        self.current = self.stages[DOCTOR]
        self.held: dict[str, object] | None = None
        self._identities: dict[str, dict[str, str]] = {}

    def all(self) -> None:
        """Run every stage; raise `Aborted` if a person or a signal ends the acceptance."""
        self._look()
        self._contracts()
        stage = self.current = self.stages[MOTION]
        stage.why = "not done"
        if "servos" not in self._config.devices():
            stage.end(Verdict.PASS, "the bench has no servos: nothing can turn")
        elif any(s.verdict == Verdict.FAIL.value for s in self.stages.values()):
            stage.end(Verdict.ABORTED, "not done: first repair what failed above, then accept again")
        else:
            self._may_turn()
            self._turn(stage)

    def verdict(self) -> Verdict:
        """Return the verdict of the acceptance: FAIL, else ABORTED, if a stage has it; else PASS."""
        verdicts = {stage.verdict for stage in self.stages.values()}
        return next((v for v in (Verdict.FAIL, Verdict.ABORTED) if v.value in verdicts), Verdict.PASS)

    def exit_code(self) -> int:
        """Return the exit code of `hil`: like `hil doctor`, 3 if the doctor found a faulty device."""
        if self.verdict() is Verdict.PASS:
            return EXIT_PASS
        if self.verdict() is Verdict.ABORTED:
            return EXIT_ABORTED
        sick = self.stages[DOCTOR].verdict == Verdict.FAIL.value
        return EXIT_DEVICE if sick else EXIT_LIMIT_FAILED

    def devices(self) -> dict[str, dict[str, Any]]:
        """Return the backend (real or emulated), the model and the reported identity of each device."""
        real = self._request.source.real
        return {
            name: {
                "backend": "real" if name in real else "emulated",
                "model": getattr(table, "model", name),
                "identity": self._identities.get(name, {}),
            }
            for name, table in self._config.devices().items()
        }

    def _opened(self) -> tuple[Bench, list[Finding]]:
        source = self._request.source
        return open_degraded(
            source.bench,
            emulate=source.emulate,
            seed=source.seed,
            realtime=source.realtime,
            faults=source.faults,
            overrides=source.overrides,
            calibration=source.calibration,
        )

    def _look(self) -> None:
        """Run the checks of `hil doctor`."""
        stage, total = self.stages[DOCTOR], len(self._config.devices())
        self._request.report(DOCTOR, 0, total)
        with self._request.interrupts.interruptible():
            bench, stage.findings = self._opened()
            seen = {f.device for f in stage.findings}
            for finding in examine(bench, watch_s=self._request.watch_s):
                self._request.interrupts.stop_here()
                stage.findings.append(finding)
                if finding.device in self._config.devices() and finding.device not in seen:
                    seen.add(finding.device)
                    self._request.report(DOCTOR, len(seen), total)
        stage.end()

    def _contracts(self) -> None:
        """Check the contract of every device that could be opened, and the age of its samples."""
        self.current, late = self.stages[CONTRACT], self.stages[LATENCY]
        if not self._request.source.virtual:
            late.findings.append(punctuality(self._config))
        closed = {
            f.device for f in self.stages[DOCTOR].findings if f.check == "open" and f.level == "failure"
        }
        devices = [name for name in self._config.devices() if name not in closed]
        anew = self._request.source.open if self._request.source.virtual else None
        bench, _ = self._opened()
        try:
            bench.begin()
            for number, name in enumerate(devices):
                self._request.report(CONTRACT, number, len(devices))
                subject = Subject(bench, name, anew)
                for promise, check in AT_REST.items():
                    self._one(self.current, name, promise, partial(check, subject))
                self._one(late, name, "age of samples", partial(delays_at_rest, subject))
                if "watched" in subject.__dict__:
                    self._identities[name] = dict(subject.watched.identity)
        finally:
            bench.close()
        self._request.report(CONTRACT, len(devices), max(len(devices), 1))
        left = f"not checked, because they do not open: {', '.join(sorted(closed))}" if closed else ""
        for stage in (self.current, late):
            stage.end(left_out=left)

    def _one(self, stage: Stage, device: str, promise: str, check: Callable[[], str]) -> None:
        """Run one check; a signal before or during the check ends the acceptance."""
        self._request.interrupts.finish_here()
        with self._request.interrupts.interruptible():
            finding = judged(device, promise, check)
            self._request.interrupts.stop_here()  # an interrupted check says nothing about the device
        stage.findings.append(finding)

    def _may_turn(self) -> None:
        """Raise `Aborted` unless the servos are emulated or a person confirms that the wheels are free."""
        asked = self._request
        if "servos" not in asked.source.real or asked.on_stand:
            return
        with asked.interrupts.interruptible():
            answer = asked.operator.ask(QUESTION)
        if answer.strip().lower() != "yes":
            raise Aborted(
                "the wheels did not turn: it was not confirmed that the robot is on a stand",
                expected="the word yes",
                remedy="put it on a stand, then accept again",
            )

    def _turn(self, stage: Stage) -> None:
        """Check contract and delays of the servos in motion; stop after the first failed check."""
        source = self._request.source.changed(overrides=off_the_wall(self._config)).with_its_faults()
        bench = source.open()
        bench.warns_not_held = False
        try:
            with bench:
                self._checks_in_motion(stage, bench)
        except Aborted:
            raise
        except HilError as error:
            device = str(getattr(error, "device", "bench"))
            stage.findings.append(Finding.of_error(device, "open", error))
        finally:
            self.held = bench.held.to_json() if bench.held.opened else None
        stage.end()

    def _checks_in_motion(self, stage: Stage, bench: Bench) -> None:
        total = len(IN_MOTION) + 1
        for number, (promise, check) in enumerate(IN_MOTION.items()):
            self._request.report(MOTION, number, total)
            self._one(stage, "servos", promise, partial(check, bench))
            if stage.findings[-1].level == "failure":
                return
        self._request.report(MOTION, total - 1, total)
        found: list[Finding] = []
        delays = without_restart(lambda bench: _collected(found, delays_in_motion(bench)))
        self._one(stage, "servos", "delays", partial(delays, bench))
        stage.findings += found
        self._request.report(MOTION, total, total)


def _collected(found: list[Finding], findings: Iterator[Finding]) -> str:
    found += findings
    return "measured"


def _files(source: BenchSource) -> Iterator[dict[str, str]]:
    """Yield the files that define the bench, with their SHA-256: a signature on the report covers these."""
    config = source.config
    used = json.dumps(config.model_dump(mode="json", by_alias=True), sort_keys=True).encode()
    if isinstance(source.bench, (str, Path)) and Path(source.bench).is_file():
        yield _file("bench file", Path(source.bench))
    yield {"what": "configuration as used", "path": config.name, "sha256": hashlib.sha256(used).hexdigest()}
    if config.record.folder and (Path(config.record.folder) / "record.toml").is_file():
        yield _file("record of the robot", Path(config.record.folder) / "record.toml")
    calibration = source.describe_calibration()
    if calibration is not None:
        yield {
            "what": f"calibration, version {calibration['version']}",
            "path": calibration["path"],
            "sha256": calibration["sha256"],
        }


def _file(what: str, path: Path) -> dict[str, str]:
    return {"what": what, "path": str(path), "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
