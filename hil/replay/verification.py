"""Verifies that a recording repeats: its inputs go through the pipeline again, and every number is compared.

Where the same arithmetic decides, every bit must be equal. Where it is another one, numbers may differ within
the limits of `hil.replay.difference_limits`.
"""

import re
from collections import deque
from collections.abc import Iterable
from typing import Any

from hil.bench.pipelines import BenchModel
from hil.controller.joint_script import SCRIPT, JointScript
from hil.core.errors import SafetyStop, UsageError
from hil.core.external_commands import ExternalCommands
from hil.core.known_names import ESTIMATORS, JOG, LAWS, ROS2
from hil.core.signals import CycleRecord, Inputs, Reference
from hil.loop.pipeline import OUTSIDE, ControlPipeline
from hil.recording.record_comparison import first_difference
from hil.recording.runs import RecordedRun, RunStart, read_cycles_of_runs
from hil.replay.difference_limits import LIMITS, Agreement, same_text
from hil.replay.recordings import OpenedRecording
from hil.robot.trajectories import Trajectory
from hil.support.arithmetic_fingerprint import fingerprint

IDENTICAL, AGREES, DIFFERS = "identical", "agrees", "differs"
"""Verdicts, from best to worst."""
DECIDED = ("measurements", "state", "reference", "setpoint", "command", "events", "observers")
"""Fields of a cycle record that the pipeline computes from its inputs."""
FLIP = (
    "A sample or an event that falls to the other side of its threshold is more than the limits allow, and "
    "all that follows differs, too. Such a flip may come from the other arithmetic alone"
)
"""Remark where a flag, a count or an event differs under another arithmetic."""
EXACT = "The arithmetic is that of the recording, so every bit has to be equal"
"""Remark on a difference where the fingerprints are the same."""
MISSING = "Cycles are missing, so those after them cannot be verified; no number that was compared differs"
"""Remark on a run with a gap."""
_STOP = re.compile(r"robot stopped \((\w+)\): (.*)", re.DOTALL)
"""Text of a `SafetyStop`."""


class RecordedReferences:
    """The recorded references in order, in place of a trajectory that cannot be built again."""

    def __init__(self, records: Iterable[CycleRecord] = ()) -> None:
        self._records = deque(records)

    def add(self, record: CycleRecord) -> None:
        """Take the reference of a further cycle."""
        self._records.append(record)

    def __call__(self, t_s: float) -> Reference:
        """Reference of the next cycle.

        Raises:
            SafetyStop: an external command stopped the robot in that cycle.
        """
        record = self._records.popleft()
        if record.reference is None:
            said = [e.message for e in record.events if e.level == "error"]
            found = _STOP.fullmatch(said[-1]) if said else None
            if found is None:
                raise ValueError(f"the recording has no reference at {t_s:.3f} s")
            raise SafetyStop(*found.groups())
        return record.reference


class RecordedCommands:
    """The recorded commands of a program that drove, cycle by cycle, in place of the program."""

    def __init__(self) -> None:
        self._latest = ExternalCommands()

    def add(self, record: CycleRecord) -> None:
        """Take the commands of a further cycle."""
        self._latest = record.external or ExternalCommands()

    def __call__(self, _: CycleRecord) -> ExternalCommands:
        """Commands of the latest cycle."""
        return self._latest


def verify_cycle(
    cycle: CycleRecord, pipeline: ControlPipeline, agreement: Agreement, *, exact: bool
) -> tuple[str, str]:
    """Let a pipeline decide on one recorded cycle, the next of its run, and compare.

    Args:
        cycle: cycle as recorded.
        pipeline: pipeline, rebuilt for the run.
        agreement: largest differences so far, to which those of this cycle are added.
        exact: True if every bit must be equal.

    Returns:
        Verdict, and the first difference in words where that is `differs`.
    """
    if cycle.inputs == Inputs(cycle.cycle, cycle.inputs.t_ns) and _from_outside(cycle):
        return IDENTICAL, ""
    try:
        decision = pipeline.decide(cycle.inputs)
    except SafetyStop as stop:
        return _compare_stop(cycle, str(stop), exact=exact)
    recorded = {name: getattr(cycle, name) for name in DECIDED}
    decided = {name: getattr(decision, name) for name in DECIDED}
    difference = first_difference(recorded, decided)
    if difference is None:
        return IDENTICAL, ""
    beyond = agreement.take(recorded, decided)
    if exact:
        return DIFFERS, difference
    return (AGREES, "") if beyond is None else (DIFFERS, beyond)


def _compare_stop(record: CycleRecord, stop: str, *, exact: bool) -> tuple[str, str]:
    """Verdict and first difference of a cycle in which the pipeline stops the robot."""
    said = [event.message for event in record.events]
    if said == [stop]:
        return IDENTICAL, ""
    if not exact and len(said) == 1 and same_text(said[0], stop):
        return AGREES, ""
    return DIFFERS, f"events: replay stopped the robot: {stop}"


def _from_outside(record: CycleRecord) -> bool:
    """Whether a record only says that something other than the pipeline ended the run."""
    return [e.source for e in record.events] == [OUTSIDE]


def rebuild(bench: BenchModel, start: RunStart) -> ControlPipeline:
    """The pipeline of a recorded run.

    References are computed again from the trajectory; those that came from outside (velocity commands) wait
    in an empty `RecordedReferences` for the records, commands of a program that drove in `RecordedCommands`.

    Raises:
        UsageError: the note on how the run began describes no pipeline of this version.
    """
    trajectory: Trajectory | JointScript | None = None
    if start.controller == SCRIPT and start.trajectory is not None:
        trajectory = JointScript.from_mapping(start.trajectory)
    elif start.trajectory is not None:
        trajectory = Trajectory.from_mapping(start.trajectory)
    pipeline = bench.make_pipeline(
        trajectory, controller=start.controller, feedback=start.feedback, observers=start.observers
    )
    if start.trajectory is not None and start.trajectory.get("references") == "recorded":
        pipeline.reference_at = RecordedReferences()
    if pipeline.external is not None:
        pipeline.external.ask = RecordedCommands()
    return pipeline


class RunCheck:
    """Checks cycle by cycle whether a run repeats, without keeping cycles in memory.

    Args:
        bench: bench that made it.
        start: begin of the run, None if the recording does not contain it.
        exact: True if every bit must be equal, as with the arithmetic of the recording.
        number: number of the run in its recording.

    Attributes:
        result: `run` (its number), `cycles`, `verdict`, `verified` (field names), `references` (`computed`,
            `recorded` or `none`), `difference`: the first one beyond what `exact` allows in words, None
            without; with another arithmetic a `remark` where a flag, a count or an event differs.
        agreement: the largest differences.
    """

    def __init__(
        self, bench: BenchModel, start: RunStart | None, *, exact: bool = True, number: int = 0
    ) -> None:
        self.result: dict[str, Any] = {
            "run": number,
            "cycles": 0,
            "verdict": IDENTICAL,
            "verified": [],
            "references": "none",
            "difference": None,
        }
        self.agreement, self._exact = Agreement(), exact
        self._latest: int | None = None
        problem = "the recording does not say how this run began" if start is None else _foreign(start)
        if start is None or problem:
            self._differs(problem)
            return
        self._pipeline = rebuild(bench, start)
        ask = None if self._pipeline.external is None else self._pipeline.external.ask
        self._asked = ask if isinstance(ask, RecordedCommands) else None
        self._given = self._pipeline.reference_at if _are_recorded(self._pipeline) else None
        if self._pipeline.reference_at is not None:
            self.result["references"] = "computed" if self._given is None else "recorded"
        self.result["verified"] = list(DECIDED)
        self._pipeline.reset(start.state)

    def take(self, record: CycleRecord) -> None:
        """Compare the next cycle with what the pipeline makes of it; after a difference only count."""
        self.result["cycles"] += 1
        if self.result["difference"] is not None:
            return
        if self._latest is not None and record.cycle != self._latest + 1:
            self._differs(f"cycle {record.cycle}: the cycles before it are missing")
            self.result["remark"] = MISSING
            return
        self._latest = record.cycle
        if isinstance(self._given, RecordedReferences):
            self._given.add(record)
        if self._asked is not None:
            self._asked.add(record)
        verdict, difference = verify_cycle(record, self._pipeline, self.agreement, exact=self._exact)
        if verdict == DIFFERS:
            self._differs(f"cycle {record.cycle}: {difference}")
            flip = self.agreement.flip
            if self._exact:
                self.result["remark"] = EXACT
            elif flip is not None:
                self.result["remark"] = f"{FLIP}: {flip}."
        elif verdict == AGREES:
            self.result["verdict"] = AGREES

    def _differs(self, difference: str) -> None:
        self.result |= {"verdict": DIFFERS, "difference": difference}


def _foreign(start: RunStart) -> str:
    """Names the parts of a run that cannot run again because they are not of this package; else empty."""
    named = start.controller
    known = named in (None, SCRIPT, *LAWS) or (named is not None and named.startswith((ROS2, JOG)))
    laws = () if known else (named,)
    filters = [name for name in (start.feedback, *start.observers) if name not in ESTIMATORS]
    reported = [*(f"controller {name}" for name in laws), *(f"estimator {name}" for name in filters)]
    if not reported:
        return ""
    return f"{' and '.join(reported)}: not part of this package, so that replay cannot make it again"


def _are_recorded(pipeline: ControlPipeline) -> bool:
    return isinstance(pipeline.reference_at, RecordedReferences)


def verify_run(bench: BenchModel, run: RecordedRun) -> dict[str, Any]:
    """Whether a run repeats bit for bit; see `RunCheck.result`."""
    check = RunCheck(bench, run.start)
    for record in run.records:
        check.take(record)
    return check.result


def verify_recording(opened: OpenedRecording, number: int | None = None) -> dict[str, Any]:
    """Whether every run of a recording repeats, or one by its number.

    A recording of ours is verified in one pass, cycle by cycle, so its length needs no memory.

    Returns:
        `verdict` (the worst of all runs), `recorded_with` and `verified_with` (fingerprints of the
        arithmetic), `largest` (difference by quantity) beside `limits`, and `runs` (`RunCheck.result` of
        each).

    Raises:
        DataError: there are no cycles.
        UsageError: no run of that number, or a recording of other origin: no pipeline decided in it.
    """
    if opened.foreign:
        raise UsageError(
            f"{opened.path}: not a recording of this bench: there is nothing to verify",
            expected="an .mcap recording that a run or `hil live` has made",
            remedy="leave --verify out",
        )
    recorded_with, here = opened.header.get("arithmetic", {}), fingerprint()
    checks, check, latest, count = list[RunCheck](), None, -1, 0
    for k, start, record in read_cycles_of_runs(opened.path, opened.problems):
        count = k + 1
        if number is not None and k != number:
            continue
        if check is None or k != latest:
            check = RunCheck(opened.bench, start, exact=recorded_with == here, number=k)
            latest = k
            checks.append(check)
        check.take(record)
    opened.must_hold(count, number)
    return {
        **_summary(checks),
        "recorded_with": recorded_with,
        "verified_with": here,
        "runs": [check.result for check in checks],
    }


def _summary(checks: list[RunCheck]) -> dict[str, Any]:
    """Verdict over several runs, and the largest difference of each quantity in any of them."""
    verdicts = {check.result["verdict"] for check in checks}
    found = [check.agreement.largest for check in checks]
    largest = {
        name: max(one.get(name, 0.0) for one in found) for name in LIMITS if any(name in f for f in found)
    }
    return {
        "verdict": next(v for v in (DIFFERS, AGREES, IDENTICAL) if v in verdicts),
        "largest": largest,
        "limits": {name: {"value": limit.value, "unit": limit.unit} for name, limit in LIMITS.items()},
    }
