"""Whether a recording repeats: its inputs go through the brain again, and every bit is held against it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from hil.bench.blueprint import Blueprint
from hil.controller.joint_script import SCRIPT, JointScript
from hil.recording.compare import first_difference
from hil.recording.cycle_codec import DECIDED
from hil.recording.cycle_decoder import StoredCycle
from hil.recording.runs import RecordedRun, RunStart, read_stored_cycles
from hil.replay.recordings import OpenedRecording
from hil.ring.loop import OUTSIDE, Brain, Decision
from hil.robot.trajectories import Trajectory
from hil.vocabulary.choices import ESTIMATORS, LAWS
from hil.vocabulary.collector import without_collector
from hil.vocabulary.errors import SafetyStop, UsageError
from hil.vocabulary.signals import CycleRecord, Inputs, Reference, RobotState

FIELDS = DECIDED
ESTIMATION = ("measurements", "state", "reference", "events")
_REWORDED = (" tells a step of ", " reports a step of ")
"""What recordings up to version 0.1 say of a servo whose encoder slips, and what is said now."""


@dataclass(frozen=True)
class Mismatch:
    """First place in which a replay differs from its recording."""

    cycle: int
    field: str


class RecordedReferences:
    """The recorded references in their order: stands in for a trajectory that cannot be built again."""

    def __init__(self, records: Iterable[CycleRecord] = ()) -> None:
        self._references = deque(r.reference for r in records)

    def add(self, record: CycleRecord) -> None:
        """Take the reference of a further cycle."""
        self._references.append(record.reference)

    def __call__(self, t_s: float) -> Reference:
        """Reference of the next cycle."""
        reference = self._references.popleft()
        if reference is None:
            raise ValueError(f"the recording has no reference at {t_s:.3f} s")
        return reference


def verify(
    records: Iterable[CycleRecord], brain: Brain, start: RobotState, fields: tuple[str, ...] = FIELDS
) -> Mismatch | None:
    """Whether a brain decides on the recorded inputs exactly what was recorded.

    Args:
        records: one run from its first cycle.
        brain: put together as for the run.
        start: state that the run was started from.
        fields: what to hold against the recording; `ESTIMATION` for a brain without the controller.

    Returns:
        The first difference, or None if every bit agrees.
    """
    brain.reset(start)
    return next(filter(None, (verify_cycle(record, brain, fields) for record in records)), None)


def verify_cycle(
    cycle: CycleRecord | StoredCycle, brain: Brain, fields: tuple[str, ...] = FIELDS
) -> Mismatch | None:
    """Let a brain decide on one recorded cycle, the next of its run; its first difference.

    A stored cycle is held against the decision as bytes; it is only read where they differ.
    """
    if cycle.inputs == Inputs(cycle.cycle, cycle.inputs.t_ns) and _from_outside(_read(cycle)):
        return None
    try:
        decision = brain.decide(cycle.inputs)
    except SafetyStop as stop:
        record = _read(cycle)
        if [e.message for e in record.events] == [str(stop)]:
            return None
        return Mismatch(cycle.cycle, f"events: replay stopped the robot: {stop}")
    if isinstance(cycle, StoredCycle) and fields == FIELDS and cycle.holds(decision):
        return None
    cycle = _read(cycle)
    if decision.observers and not cycle.observers:
        decision = _as_once(decision)
    recorded = {name: getattr(cycle, name) for name in fields}
    found = first_difference(recorded, {name: getattr(decision, name) for name in fields})
    return None if found is None else Mismatch(cycle.cycle, found)


def _as_once(decision: Decision) -> Decision:
    """A decision as recordings up to version 0.1 keep it: observers as figures among the diagnostics."""
    figures = dict(decision.state.diagnostics)
    for name, state in decision.observers.items():
        (x_m, y_m, theta_rad), covariance = state.pose_body_in_wall.tolist(), state.covariance
        figures |= {
            f"{name}_x_m": x_m, f"{name}_y_m": y_m, f"{name}_theta_rad": theta_rad,
            f"{name}_xx_m2": covariance.item(0, 0), f"{name}_xy_m2": covariance.item(0, 1),
            f"{name}_yy_m2": covariance.item(1, 1),
        }  # fmt: skip
    return replace(decision, state=replace(decision.state, diagnostics=figures), observers={})


def _read(cycle: CycleRecord | StoredCycle) -> CycleRecord:
    """A record, its events in the words of today."""
    record = cycle.record if isinstance(cycle, StoredCycle) else cycle
    if not any(_REWORDED[0] in event.message for event in record.events):
        return record
    events = tuple(replace(event, message=event.message.replace(*_REWORDED)) for event in record.events)
    return replace(record, events=events)


def _from_outside(record: CycleRecord) -> bool:
    """Whether a record only says that something other than the brain ended the run."""
    return [e.source for e in record.events] == [OUTSIDE]


def rebuild(bench: Blueprint, start: RunStart) -> Brain:
    """The brain of a recorded run.

    References are computed again from the trajectory; those that came from outside (velocity commands) wait
    in an empty `RecordedReferences` for the records.

    Raises:
        UsageError: the note on how the run began describes no brain of this version.
    """
    trajectory: Trajectory | JointScript | None = None
    if start.controller == SCRIPT and start.trajectory is not None:
        trajectory = JointScript.from_mapping(start.trajectory)
    elif start.trajectory is not None:
        trajectory = Trajectory.from_mapping(start.trajectory)
    brain = bench.make_brain(
        trajectory, controller=start.controller, feedback=start.feedback, observers=start.observers
    )
    if start.trajectory is not None and start.trajectory.get("references") == "recorded":
        brain.reference_at = RecordedReferences()
    return brain


class RunCheck:
    """Whether a run repeats bit for bit, told cycle by cycle, so that none has to be kept.

    Args:
        bench: of its making.
        start: how it began, None where the recording does not say.

    Attributes:
        told: `cycles`, `verified` (field names), `references` (`computed`, `recorded` or `none`) and
            `difference`: the first one in words, None without.
    """

    def __init__(self, bench: Blueprint, start: RunStart | None) -> None:
        self.told: dict[str, Any] = {
            "cycles": 0, "verified": [], "references": "none", "difference": None
        }  # fmt: skip
        self._latest: int | None = None
        problem = "the recording does not say how this run began" if start is None else _foreign(start)
        if start is None or problem:
            self.told["difference"] = problem
            return
        self._brain = rebuild(bench, start)
        self._given = self._brain.reference_at if _are_recorded(self._brain) else None
        if self._brain.reference_at is not None:
            self.told["references"] = "computed" if self._given is None else "recorded"
        self.told["verified"] = list(FIELDS)
        self._brain.reset(start.state)

    def take(self, record: CycleRecord | StoredCycle) -> None:
        """Hold the next cycle against what the brain makes of it; after a difference only count."""
        self.told["cycles"] += 1
        if self.told["difference"] is not None:
            return
        if self._latest is not None and record.cycle != self._latest + 1:
            self.told["difference"] = f"cycle {record.cycle}: the cycles before it were not recorded"
            return
        self._latest = record.cycle
        if isinstance(self._given, RecordedReferences):
            self._given.add(record.record if isinstance(record, StoredCycle) else record)
        found = verify_cycle(record, self._brain)
        if found is not None:
            self.told["difference"] = f"cycle {found.cycle}: {found.field}"


def _foreign(start: RunStart) -> str:
    """Which parts of a run cannot be made again, because they are not of this package; empty for none."""
    laws = (start.controller,) if start.controller not in (None, SCRIPT, *LAWS) else ()
    filters = [name for name in (start.feedback, *start.observers) if name not in ESTIMATORS]
    told = [*(f"controller {name}" for name in laws), *(f"estimator {name}" for name in filters)]
    if not told:
        return ""
    return f"{' and '.join(told)}: not part of this package, so that replay cannot make it again"


def _are_recorded(brain: Brain) -> bool:
    return isinstance(brain.reference_at, RecordedReferences)


def verify_run(bench: Blueprint, run: RecordedRun) -> dict[str, Any]:
    """Whether a run repeats bit for bit; see `RunCheck.told`."""
    check = RunCheck(bench, run.start)
    with without_collector():
        for record in run.records:
            check.take(record)
    return check.told


def verify_recording(opened: OpenedRecording, number: int | None = None) -> list[dict[str, Any]]:
    """Whether every run of a recording repeats, or one by its number; see `RunCheck.told`.

    A recording of ours is read, decided upon and let go of in one pass, whatever its length.

    Raises:
        DataError: there are no cycles.
        UsageError: no run of that number, or a recording of other origin: no brain decided in it.
    """
    if opened.foreign:
        raise UsageError(
            f"{opened.path}: not a recording of this bench: there is nothing to verify",
            expected="an .mcap recording that a run or `hil live` has made", remedy="leave --verify out",
        )  # fmt: skip
    told, check, latest, count = [], None, -1, 0
    with without_collector():
        for k, start, record in read_stored_cycles(opened.path, opened.problems):
            count = k + 1
            if number is not None and k != number:
                continue
            if check is None or k != latest:
                check, latest = RunCheck(opened.bench, start), k
                told.append(check.told)
            check.take(record)
    opened.must_hold(count, number)
    return told
