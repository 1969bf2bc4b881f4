"""One session of the live loop: settle, follow a reference or commands, until it is done or ended.

Whatever ends it, the robot is stopped, and the summary says whether it is held.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.bench import Bench
from hil.bench.loop_settings import motion_limits
from hil.config.servos import ServosConfig
from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import Aborted, HilError
from hil.core.geometry import Array
from hil.core.interfaces import Sink
from hil.core.known_names import JOG
from hil.core.registry import sample_names
from hil.core.signals import CycleRecord, Status, worst
from hil.live.reference_files import MakeTrajectory
from hil.live.velocity_input import CommandLines
from hil.live.velocity_reference import VelocityReference
from hil.loop.pipeline import ControlPipeline
from hil.loop.realtime import warm_up
from hil.loop.timing import LateWarning, advice
from hil.monitor import RerunMonitor
from hil.recording.mcap_writer import McapRecorder
from hil.recording.runs import RunStart
from hil.robot.paths import Segment, Straight
from hil.robot.trajectories import Trajectory
from hil.support.interrupt_signals import StopRequest

_SETTLE_S = 0.5
HOLD_S = 2.0
"""Time (s) for which a robot is held at the end of a trajectory if no duration is given."""
_PATH_POINTS = 400
_HEADING_MARGIN_RAD = 0.035


@dataclass
class SampleCount:
    """Samples of one device.

    Attributes:
        received: number of samples; `bad` counts, by status, those with a channel that is not OK.
        missing: sequence numbers that were skipped: lost samples.
    """

    received: int = 0
    missing: int = 0
    bad: Counter[str] = field(default_factory=Counter)
    last_seq: int | None = None

    def add(self, sample: Any) -> None:
        """Count one sample."""
        self.received += 1
        last, self.last_seq = self.last_seq, sample.stamp.seq
        if last is not None and self.last_seq - last > 1:
            self.missing += self.last_seq - last - 1
        status = worst(sample)
        if status is not Status.OK:
            self.bad[status.value] += 1

    def to_json(self) -> dict[str, object]:
        """The counts as plain data."""
        return {"received": self.received, "missing": self.missing, "bad": dict(self.bad)}


class SampleCounter(Sink):
    """Sink that counts the samples of each device."""

    def __init__(self) -> None:
        self.counts: defaultdict[str, SampleCount] = defaultdict(SampleCount)

    def write(self, record: CycleRecord) -> None:
        """Count one cycle's samples."""
        for name in sample_names(record.inputs):
            for sample in record.inputs.of(name):
                self.counts[name].add(sample)

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def to_json(self) -> dict[str, dict[str, object]]:
        """The counts as plain data, by device."""
        return {name: count.to_json() for name, count in self.counts.items()}


if TYPE_CHECKING:
    from hil.live.jog import JointJog
    from hil.live.ros2_program import Ros2Program


@dataclass(frozen=True)
class LivePlan:
    """Plan of a session.

    Attributes:
        trajectory: function that makes the reference from the robot's pose; `commands`: velocity commands to
            follow instead. With neither the session only watches.
        program: ROS 2 program that drives, along the trajectory if there is one; or an operator who moves
            one joint.
        duration_s: time after which it ends; at the trajectory's end, or never, when None.
        feedback: estimator in the loop; `observers` run beside it.
        dead_man_s: age at which a velocity command counts as `stop`.
        known: path that is known to keep the bench's limits; its segments at the end of the trajectory are
            not checked again while the robot waits.
        over: returns why the operator wants the end, empty to go on; called before the first cycle, too.
    """

    trajectory: MakeTrajectory | None = None
    commands: CommandLines | None = None
    program: Ros2Program | JointJog | None = None
    duration_s: float | None = None
    feedback: str = "ekf"
    observers: tuple[str, ...] = ()
    dead_man_s: float = 0.5
    known: Trajectory | None = None
    over: Callable[[], str] = str


class LiveSession:
    """Runs a plan on a bench; create it before entering the bench, because loading code takes time.

    Args:
        bench: devices, clock, sinks; warmed up here.
        plan: plan of the session.
        recorder: recorder for the summary; also a sink of the bench.
        monitor: monitor that shows the path to follow; also a sink of the bench.
        stop: signals as noted by the caller that opens and closes the bench; its own by default.

    Attributes:
        ended: reason of its end: `duration`, `trajectory`, the first signal's name, or the error's text.
    """

    def __init__(
        self,
        bench: Bench,
        plan: LivePlan,
        *,
        recorder: McapRecorder | None = None,
        monitor: RerunMonitor | None = None,
        stop: StopRequest | None = None,
    ) -> None:
        self.bench, self.plan, self.recorder, self.monitor = bench, plan, recorder, monitor
        self.ended = ""
        self._stop = stop or StopRequest()
        self._samples = SampleCounter()
        self._burdens = ["--observe"] * bool(plan.observers) + ["--rerun"] * (monitor is not None)
        self._late = LateWarning(bench.config.loop.rate_hz, self._burdens)
        self._last: CycleRecord | None = None
        self._velocity: VelocityReference | None = None
        self._commands = plan.commands
        self._first_ns: int | None = None
        bench.waits_for_sensors = not self._moving
        here = np.array(bench.config.environment.start_pose, dtype=np.float64)
        standing = _standing(here) if self._moving else None
        warm_up(self._pipeline(standing), self.bench.start_state(here))
        if bench.driven_by is not None:  # it may turn out to send velocities, which only move the reference
            program, bench.driven_by = bench.driven_by, None
            warm_up(self._pipeline(standing), self.bench.start_state(here))
            bench.driven_by = program

    def run(self) -> None:
        """Settle, then cycle until the end.

        Raises:
            Aborted: a signal ended it.
            SafetyStop, DeviceError, TrajectoryError: as the loop raised them; the robot is stopped.
        """
        with self._stop.noted():
            try:
                self._run()
            except HilError as error:
                self.ended = self.ended or str(error)
                raise

    def summary(self) -> dict[str, object]:
        """What happened: duration, punctuality, samples, last pose, recording."""
        last, bench = self._last, self.bench
        joint = (self._driver or "").startswith(JOG)  # odometry of one wheel is not the robot's pose
        pose = None if last is None or joint else [float(v) for v in last.state.pose_body_in_wall]
        found: dict[str, object] = {
            "bench": bench.config.name,
            "ended": self.ended,
            "rate_hz": bench.config.loop.rate_hz,
            "timing": bench.statistics.summary(),
            "samples": self._samples.to_json(),
            "pose": pose,
            "events": bench.seen.rows(),
            "held": bench.held.to_json(),
            "first_cycle_s": bench.first_cycle_ns / NS_PER_S,
        }
        if injected := bench.injection.report():
            found["injected"] = injected
        if missed := bench.faults_not_met():
            found["faults_not_met"] = list(map(str, missed))
            found["note"] = bench.not_met_in_words(missed)
        if said := advice(bench.statistics.summary(), bench.config.loop.rate_hz, self._burdens):
            found["advice"] = said
        if bench.real_time is not None:
            found["real_time"] = {
                "warnings": list(bench.real_time.warnings),
                "collections": bench.real_time.collections,
            }
        if self._velocity is not None:
            found["commands"] = {
                "accepted": self._velocity.accepted,
                "refused": self._velocity.refused,
                **({} if self._commands is None else self._commands.counts()),
                "dead_man_stops": self._velocity.dead_man_stops,
            }
        elif self.plan.program is not None:
            found["commands"] = dict(self.plan.program.counts())
        if self.recorder is not None:
            found["recording"] = self.recorder.report()
        return found

    def _run(self) -> None:
        bench, plan = self.bench, self.plan
        self.end_if_asked()
        bench.config.must_know_start()
        if self._moving:
            bench.devices.actuators().enable()
        pose = self._settled()
        if plan.program is not None:
            if not plan.program.found():
                start = RunStart(bench.start_state(pose), plan.feedback)
                plan.program.wait(bench, start, self._is_over(lambda: 0, "duration", plan.duration_s))
                if self.ended:
                    self._must_not_be_asked()
                    return
                pose = self._settled()
            if plan.trajectory is None and not plan.program.sends_joints():
                bench.driven_by, self._commands = None, plan.program.velocities()
        trajectory = self._trajectory(pose) if self._follows else None
        pipeline = self._pipeline(trajectory)
        if self._commands is not None:
            self._velocity = self._obey(self._commands, pose)
            pipeline.reference_at = self._velocity
        self._cycle(pipeline, trajectory, pose)

    def _settled(self) -> Array:
        """Rest for a moment, and return the pose (3,)."""
        rest = self.bench.observe(
            _SETTLE_S, feedback=self.plan.feedback, on_cycle=lambda _: self.end_if_asked()
        )
        return self.bench.measured_pose(rest.mocap)

    @property
    def _moving(self) -> bool:
        return self._follows or self.plan.program is not None

    @property
    def _follows(self) -> bool:
        """Whether there is a reference."""
        return self.plan.trajectory is not None or self._commands is not None

    @property
    def _driver(self) -> str | None:
        """Name of a program that drives the wheels; None where the bench's own law does."""
        return None if self.bench.driven_by is None else self.bench.driven_by[0]

    def _pipeline(self, trajectory: Trajectory | None) -> ControlPipeline:
        plan = self.plan
        return self.bench.make_pipeline(
            trajectory, controller=self._driver, feedback=plan.feedback, observers=plan.observers
        )

    def _trajectory(self, pose: Array) -> Trajectory:
        """The checked trajectory to follow; for velocity commands one that stays at the start pose."""
        if self.plan.trajectory is None:
            return _standing(pose)
        trajectory = self.plan.trajectory(pose)
        self.bench.check(trajectory, known=self.plan.known)
        if self.monitor is not None:
            times_s = np.linspace(0.0, trajectory.duration_s, _PATH_POINTS)
            self.monitor.show_path(trajectory.sample_many(times_s)[0][:, :2])
        return trajectory

    def _obey(self, lines: CommandLines, pose: Array) -> VelocityReference:
        limits, servos = motion_limits(self.bench.config), self.bench.config.of(ServosConfig)
        if limits.heading_limit_rad is not None:
            limits = replace(limits, heading_limit_rad=limits.heading_limit_rad - _HEADING_MARGIN_RAD)
        return VelocityReference(
            lines,
            pose,
            self.bench.geometry.projection(),
            limits,
            dead_man_s=self.plan.dead_man_s,
            stops_after_s=servos.watchdog_s if servos is not None else 0.0,
        )

    def _cycle(self, pipeline: ControlPipeline, trajectory: Trajectory | None, pose: Array) -> None:
        bench, plan = self.bench, self.plan
        law = self._driver or (None if trajectory is None else bench.config.control.law)
        reported = None if trajectory is None else trajectory.to_mapping()
        if reported is not None and self._commands is not None:
            reported["references"] = "recorded"
        bench.add_sink(self._samples)
        start = RunStart(self.bench.start_state(pose), plan.feedback, law, plan.observers, reported)
        reason, length_s, waited_ns = "duration", plan.duration_s, lambda: 0
        if length_s is None and plan.trajectory is not None and trajectory is not None:
            reason, length_s = "trajectory", trajectory.duration_s + HOLD_S
            self._first_ns, waited_ns = None, lambda: pipeline.waited_ns
        bench.run(pipeline, start, self._is_over(waited_ns, reason, length_s))
        self._must_not_be_asked()

    def _must_not_be_asked(self) -> None:
        if self._stop.name:
            raise Aborted(f"ended by {self._stop.name}")

    def _is_over(
        self, waited_ns: Callable[[], int], reason: str, length_s: float | None
    ) -> Callable[[CycleRecord], bool]:
        """The condition that ends the loop; notes the latest record and why it ended.

        Args:
            waited_ns: function to the time by which the end is delayed.
            reason: reason of an end after `length_s`.
            length_s: duration from the first cycle on; None for no end.
        """

        def over(record: CycleRecord) -> bool:
            self._last = record
            self._late.look(self.bench.statistics)
            if self.plan.program is not None:
                self.plan.program.look(record.start_ns)
            if self._first_ns is None:
                self._first_ns = record.start_ns
            if self._stop.name:
                self.ended = self._stop.name
            elif why := self.plan.over():
                self.ended = why
            elif length_s is not None and record.start_ns >= self._first_ns + waited_ns() + nanoseconds(
                length_s
            ):
                self.ended = reason
            return bool(self.ended)

        return over

    def end_if_asked(self) -> None:
        """Before anything moves: raise `Aborted` if a signal or the operator has asked for the end."""
        if why := self._stop.name or self.plan.over():
            self.ended = why
            raise Aborted(f"ended by {why} before the robot was asked to move")


def _standing(pose: Array) -> Trajectory:
    here = (float(pose[0]), float(pose[1]), float(pose[2]))
    return Trajectory("velocity", (Segment(Straight(here, here), 1.0),))
