"""Class `Bench`: opens and closes all devices together, and runs motions in the control loop."""

import logging
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import replace
from operator import attrgetter

import numpy as np

from hil.bench.cross_checks.gravity import gravity_checks
from hil.bench.cross_checks.parameters import RESTING, at_rest
from hil.bench.cross_checks.rest_watch import RestWatch, samples_of
from hil.bench.doctor.inertial_offsets import InertialWatch
from hil.bench.drive_start import (
    StartWatch,
    blind_to_the_drive,
    emulated_hold,
    forces_apart,
    must_begin_where_it_stands,
)
from hil.bench.hold.held_devices import HeldDevices
from hil.bench.injection import Injection
from hil.bench.loop_settings import real_time
from hil.bench.pipelines import BenchModel
from hil.bench.unreached_faults import acting
from hil.config.estimator import MocapNoise
from hil.controller.joint_script import JointScript
from hil.core.clock import Clock, nanoseconds
from hil.core.cross_check import CrossCheck
from hil.core.errors import ConfigError, DeviceError, HilError, SafetyStop, check_number
from hil.core.geometry import Array, ArrayLike
from hil.core.interfaces import RUN_NOTE, CommandingSink, Controller, Sink
from hil.core.known_names import LAWS
from hil.core.registry import kinds
from hil.core.signals import KINDS, CycleRecord, Event, RobotState
from hil.fakes.body_interface import PlantState
from hil.fakes.world import World
from hil.faults.fault import Fault
from hil.loop.checks.loop_pause import HELD_UP
from hil.loop.control_loop import ControlLoop
from hil.loop.device_set import DeviceSet
from hil.loop.driven_motion import Motion
from hil.loop.pipeline import ControlPipeline
from hil.loop.realtime import warm_up
from hil.loop.timing import LoopStatistics
from hil.recording.cycle_log import CycleLog
from hil.recording.runs import START_COVARIANCE, RunStart
from hil.robot.trajectories import Trajectory
from hil.support.garbage import old_objects_passed_over
from hil.user_code.checked_calls import own_name

LOG = logging.getLogger(__name__)

_SETTLE_S = 0.5
_REST_SAMPLES, _STANDS = 50, 2e-5
"""Motion-capture samples per rest; sigma (m, rad) of the residual motion of a robot at rest."""
_FRAME_MOVED_M = 0.005
"""Beyond this displacement of its frame, motion capture gives no start pose."""
_RECORDED = ("t_ns", "pose_body_in_wall", "steering_true_rad", "normal_load_n", "slip_m_s", "fallen")
"""Fields of an emulated robot's true state (`PlantState`) that are recorded."""
_recorded = attrgetter(*_RECORDED)

MakeController = Callable[[BenchModel], Controller]
OnCycle = Callable[[CycleRecord], None]
Until = Callable[[CycleRecord], bool]


class Bench(HeldDevices):
    """Devices, clock, loop and configuration of one bench; use it as a context manager.

    Attributes:
        model: everything derived from the configuration alone, without devices and clock.
        config, geometry, seed, calibration: parts of the model.
        clock: virtual or monotonic.
        devices: the devices.
        world: the emulated world if it runs in this process, else None.
        statistics: punctuality of the latest run.
        real_time: requested real-time scheduling; None in virtual time.
        pressed: force that pressed the robot on its wall before torque was switched on, as a text; empty
            where no sensor measures it.
        held: last result of `look` or, at the end, `close`. A robot that was not checked since devices were
            opened or it was driven is NOT HELD, "not checked"; if its servos were not opened, `opened` is
            False.
        warnings: warnings logged about this bench before the robot moved.
        warns_not_held: True if a warning is logged if the robot is left NOT HELD; False for programs that
            report this themselves.
        waits_for_sensors: True to wait for a lost sensor beyond its `fail_after_s`, in real time: for
            programs that watch a resting robot. Set it before the bench is entered.
        own_controller: function that makes the controller of every trajectory from the model; None for the
            configured law.
        undivided: maker of the context of each cycle, as for `ControlLoop`.
        driven_by: name of an external program that drives every trajectory, and the function that queries it;
            None without one.
        parameters: values that the bench takes for granted, and what measurements say about each.
        lost: errors of devices that ended a run of the bench, as texts.
        stopped_by: error that has ended the latest run, as a text; empty where none did.
        faults: faults planned for its devices.
        injection: faults in front of its real devices.
        seen: events of warning and above since it was opened.
    """

    def __init__(
        self,
        model: BenchModel,
        clock: Clock,
        devices: DeviceSet,
        *,
        world: World | None = None,
        sinks: tuple[Sink, ...] = (),
        faults: tuple[Fault, ...] = (),
        injection: Injection | None = None,
    ) -> None:
        super().__init__(model, clock, devices, sinks=sinks, faults=faults, injection=injection)
        self.world = world
        self.own_controller: MakeController | None = None
        self.undivided: Callable[[], AbstractContextManager[None]] = nullcontext
        self.driven_by: tuple[str, CommandingSink] | None = None
        self._left: RobotState | None = None
        self.warnings: list[str] = []
        self._inertial = InertialWatch(self.config)
        self.statistics = LoopStatistics()
        self.real_time = real_time(self.config, clock)

    def truth(self) -> PlantState | None:
        """True physical state of an emulated robot in this process; None for any other robot."""
        if self.world is None:
            return None
        self.world.sync_plant()
        return self.world.plant.truth()

    def _recorded_truth(self) -> Mapping[str, object] | None:
        """The part of `truth` that is recorded."""
        truth = self.truth()
        return None if truth is None else dict(zip(_RECORDED, _recorded(truth), strict=True))

    def settle(self, duration_s: float = _SETTLE_S) -> Array:
        """Let the robot rest, and return its pose (3,) as `measured_pose` does.

        Raises:
            ConfigError: the start pose is unknown.
        """
        return self.measured_pose(self._rest(duration_s).mocap)

    def _rest(self, duration_s: float) -> Motion:
        """Let the robot rest, and compare its samples with the bench file and the record."""
        motion = self.observe(duration_s, feedback="odometry")
        self._cross_check(at_rest(self.config, samples_of(motion.records, RESTING)))
        for changed in self._inertial.rested(motion):
            self._warn(changed, "imu")
        return motion

    def _cross_check(self, found: Iterable[CrossCheck]) -> None:
        """Add what measurements say about the bench file; warns of contradictions."""
        texts = {check.text: check.key for check in self.parameters.take(found)}
        for text, key in texts.items():
            self._warn(text, key.partition(".")[0])

    def measured_pose(self, mocap: Array) -> Array:
        """Pose of the resting robot, (3,): m, m, rad in the wall frame.

        Args:
            mocap: poses from motion capture during a rest, (n, 3); the mean is used. Without poses, or if
                motion capture sees another world than the servos', the pose is that at the end of the last
                drive; before any drive it is the configured start pose, if this robot was placed there.

        Raises:
            ConfigError: motion capture did not see a real robot, and no start pose was given.
        """
        self.config.must_know_start()
        known = mocap[np.all(np.isfinite(mocap), axis=1)]
        if len(known) and not self._capture_is_blind:
            return np.asarray(known.mean(axis=0), dtype=np.float64)
        if self._left is not None:
            return np.array(self._left.pose_body_in_wall, dtype=np.float64)
        if not self.config.placed:
            raise ConfigError(
                f"{self.config.name}: motion capture has not seen the robot while it rested",
                remedy="look at the cameras and at mocap.body, or give the start pose (--start x,y,theta)",
            )
        return np.array(self.config.environment.start_pose, dtype=np.float64)

    def observe(
        self,
        duration_s: float,
        *,
        feedback: str = "ekf",
        start_pose: ArrayLike | None = None,
        on_cycle: OnCycle | None = None,
    ) -> Motion:
        """Run the loop without commanding anything; `start_pose` (3,) as in `drive`.

        Raises:
            UsageError: the duration is below 0 or not a number, or the bench is not open.
        """
        check_number(duration_s, "duration_s", "s")
        self.must_be_open()
        start = RunStart(self.start_state(start_pose), feedback)
        return self._run(self.make_pipeline(None, feedback=feedback), start, duration_s, on_cycle)

    def drive(
        self,
        trajectory: Trajectory,
        *,
        controller: str | None = None,
        feedback: str = "ekf",
        hold_s: float = 2.0,
        observers: str | tuple[str, ...] = (),
        start_pose: ArrayLike | None = None,
        on_cycle: OnCycle | None = None,
    ) -> Motion:
        """Check a trajectory, enable the servos, settle, follow the trajectory to its end, then hold.

        Args:
            trajectory: reference; refused before anything moves if it exceeds the limits.
            controller: `nonlinear` or `optimal`; the configured law when None.
            feedback: estimator in the loop: `odometry`, `ekf` or `ukf`.
            hold_s: time for which control continues at the end, s.
            observers: one or several estimators that run in parallel.
            start_pose: pose of the robot, (3,); by default measured while settling; without motion capture
                the pose at the end of the last drive.
            on_cycle: called with every record (progress).

        Raises:
            TrajectoryError: it exceeds the limits, or does not begin at the robot's pose.
            SafetyStop, DeviceError: the robot is stopped.
            ConfigError: the start pose is unknown.
            UsageError: `hold_s` is below 0 or not a number, `trajectory` is none, the estimator or law is
                unknown, or the bench is not open.
        """
        check_number(hold_s, "hold_s", "s")
        self.check(trajectory)
        if isinstance(observers, str):
            observers = (observers,)
        stands = None if start_pose is None else self.start_state(start_pose)
        if stands is None:
            self.config.must_know_start()
        else:
            must_begin_where_it_stands(trajectory, stands.pose_body_in_wall)
        self.must_be_open()
        pipeline = self.make_pipeline(
            trajectory, controller=controller, feedback=feedback, observers=observers
        )
        warm_up(pipeline, stands or self.start_state())
        self.devices.actuators().enable()
        if stands is None:
            stands = self._where_it_stands()
            must_begin_where_it_stands(trajectory, stands.pose_body_in_wall)
        start = RunStart(
            stands, feedback, controller or self.config.control.law, observers, trajectory.to_mapping()
        )
        return self._run(pipeline, start, trajectory.duration_s + hold_s, on_cycle)

    @property
    def _capture_is_blind(self) -> bool:
        """Whether motion capture is in another world (emulated or real) than the servos."""
        return "mocap" in self.config.elsewhere()

    def _where_it_stands(self) -> RobotState:
        """State at rest at the pose from motion capture.

        Without a pose, or if its frame has moved, at the pose where the last drive ended.
        """
        left = None if self._left is None else self._hold.at_rest(self._left)
        seen = self._rest(_SETTLE_S).mocap
        moved_m = self._hold.frame_moved_m("mocap")
        unseen = self._capture_is_blind or not np.isfinite(seen).all(axis=1).any()
        if left is None or not (unseen or moved_m > _FRAME_MOVED_M):
            return self.start_state(self.measured_pose(seen))
        why = "does not see the robot" if unseen else f"has jumped by {1e3 * moved_m:.0f} mm"
        if self.has("mocap") and not self._capture_is_blind:
            self._warn(
                f"motion capture {why}: the robot is taken to stand where the last drive left it. Look at "
                "its cameras and at mocap.body, or give the start pose",
                "mocap",
            )
        return replace(left, t_ns=self.clock.now_ns())

    def start_state(self, pose: ArrayLike | None = None) -> RobotState:
        """Initial state of a run: at rest at a pose (3,), by default the configured one."""
        known = np.array(self.config.environment.start_pose if pose is None else pose, dtype=np.float64)
        covariance = start_covariance(
            self.config.estimator.mocap, measured=pose is not None and self.has("mocap")
        )
        return RobotState(self.clock.now_ns(), known, np.zeros(3), covariance)

    def _run(
        self, pipeline: ControlPipeline, start: RunStart, duration_s: float, on_cycle: OnCycle | None
    ) -> Motion:
        log = self.new_log()
        duration_ns, began_ns = nanoseconds(duration_s), None

        def until(record: CycleRecord) -> bool:
            nonlocal began_ns
            if began_ns is None:
                began_ns = record.start_ns
            log.append(record)
            if on_cycle is not None:
                on_cycle(record)
            return record.start_ns >= began_ns + duration_ns + pipeline.waited_ns

        self.run(pipeline, start, until)
        return log.motion()

    def new_log(self) -> CycleLog:
        """An empty log for the cycles of one run of this bench."""
        return CycleLog(tuple(kinds()[name] for name in self.devices.sensors if name not in KINDS))

    def run(self, pipeline: ControlPipeline, start: RunStart, until: Until, *, drop_old: bool = True) -> None:
        """Run a pipeline from a known state until `until(record)` is true; the robot is stopped at the end.

        All code is compiled and loaded before the first cycle.

        Args:
            pipeline: the pipeline that computes the commands.
            start: the arguments of `pipeline`, and the initial state.
            until: function from a record to True if it is the last.
            drop_old: True to discard samples that the devices have buffered.

        Raises:
            ConfigError: the robot is to move, and the IMU shows another tilt than `environment.tilt_rad`; or
                it is to move by a filter, and measurements contradict the bench file.
            DeviceError: the robot is to move by a filter that uses the IMU, and the IMU deviates far from its
                record.
        """
        if start.controller is not None:
            self._not_looked_at("it has been driven since bench.look() was called")
            self._warn(blind_to_the_drive(self.config))
            self._warn(forces_apart(self.config))
            if self.own_controller is None and start.controller in LAWS:
                self._warn(self.config.control.unread(start.controller))
            self._hold.tilt.must_agree()
            filtered = start.feedback != "odometry"
            if filtered:
                self._inertial.must_be_usable()
                self.parameters.must_agree()
            until = self._until_tilted(self._until_placed(until, start.state), filtered=filtered)
        self._warn(emulated_hold(self.config))
        warm_up(pipeline, start.state)
        with ExitStack() as stack:
            self.stopped_by = ""
            stack.push(self._ended_by)
            stack.enter_context(old_objects_passed_over() if self.real_time is None else self.real_time)
            if drop_old:
                self._hold.passed_over(self.devices.read(0))
            loop = self.make_loop(pipeline, start)
            if self.real_time is not None:
                loop.idle = self.real_time.idle
            try:
                loop.run(until)
            except SafetyStop as stop:
                injected = ", ".join(map(str, acting(self.faults, self.world_ns)))
                if stop.reason != HELD_UP or not injected:
                    raise
                raise stop.after(f"this run injects {injected}") from stop
            finally:
                self.parameters.lifted(pipeline.supervisor.checks.weight)
                self.parameters.moved(self.seen.contradicting)
                self._hold.stopped(pipeline.supervisor.doubted, pipeline.supervisor.agreed)
                if pipeline.external is not None:
                    self._warn(pipeline.external.warning)
                if start.controller is not None:
                    self._left = self._hold.last_state

    def _ended_by(self, _: object, error: BaseException | None, __: object) -> None:
        """Store the error that has ended a run, and that of a failed device; the error is still raised."""
        self.stopped_by = str(error) if isinstance(error, HilError) else ""
        if isinstance(error, SafetyStop):
            self.parameters.stopped(error.reason, str(error))
        if isinstance(error, DeviceError):
            self.lost.append(str(error))
            said = str(error).removeprefix(f"{error.device}: ")
            self.seen.add(Event(self.clock.now_ns(), "error", error.device, said))

    def _until_placed(self, until: Until, stands: RobotState) -> Until:
        """Wrap `until` so that motion capture is compared with the start pose in the first cycles."""
        if not self.has("mocap") or self._capture_is_blind:
            return until
        watch = StartWatch(stands.pose_body_in_wall)

        def watched(record: CycleRecord) -> bool:
            self._warn(watch.found(record), "mocap")
            return until(record)

        return watched

    def _until_tilted(self, until: Until, *, filtered: bool) -> Until:
        """Wrap `until` so that gravity is compared with the bench file once more in the first cycles."""
        self._hold.tilt.forget()
        judged, rest = False, RestWatch(self.config)

        def watched(record: CycleRecord) -> bool:
            nonlocal judged
            if not judged and self._hold.tilt.known:
                judged = True
                self._hold.tilt.must_agree()
            if rest.ends(record):
                self._cross_check(gravity_checks(self.config, rest.seen))
                if filtered:
                    self.parameters.must_agree()
            return until(record)

        return watched

    def _warn(self, said: str, source: str = "bench") -> None:
        """Log a warning once, also as an event; does nothing for an empty text."""
        if said and said not in self.warnings:
            self.warnings.append(said)
            self.seen.add(Event(self.clock.now_ns(), "warning", source, said))
            LOG.warning("%s", said)

    def make_pipeline(
        self,
        trajectory: Trajectory | JointScript | None,
        *,
        controller: str | None = None,
        feedback: str = "ekf",
        observers: tuple[str, ...] = (),
    ) -> ControlPipeline:
        """The deterministic part of the loop for one motion or script (also what replay runs).

        A user-supplied controller, or an external program that drives the bench, is used for every
        trajectory.

        Raises:
            UsageError: unknown feedback or controller.
            ConfigError: the user-supplied controller cannot be made.
        """
        if self.driven_by is not None and isinstance(trajectory, Trajectory):
            controller = self.driven_by[0]
        pipeline = self.model.make_pipeline(
            trajectory, controller=controller, feedback=feedback, observers=observers
        )
        if self.own_controller is not None and isinstance(trajectory, Trajectory):
            pipeline.controller = self.own_controller(self.model)
        return pipeline

    def make_loop(self, pipeline: ControlPipeline, start: RunStart) -> ControlLoop:
        """Make a loop over this bench's devices, clock and sinks; its statistics become the bench's.

        This resets the pipeline to the start and sends a note to the sinks; replay needs the note.

        Args:
            pipeline: the pipeline that computes the commands.
            start: the arguments of `pipeline`, and the initial state.
        """
        begun = replace(_as_decided(start, pipeline), state=replace(start.state, t_ns=self.clock.now_ns()))
        pipeline.reset(begun.state)
        if pipeline.external is not None and self.driven_by is not None:
            pipeline.external.ask = self.driven_by[1].ask
        self._note(begun.state.t_ns, RUN_NOTE, begun.note())
        config = self.config.loop
        loop = ControlLoop(
            self.devices,
            self.clock,
            pipeline,
            rate_hz=config.rate_hz,
            late_after_s=config.late_after_s,
            sinks=(*self._sinks, self._hold),
            truth=self._recorded_truth,
            undivided=self.undivided,
        )
        self.statistics = loop.statistics
        return loop


def start_covariance(noise: MocapNoise, *, measured: bool) -> Array:
    """Initial covariance of a robot at rest, (6, 6): squares of m, m, rad, m/s, m/s and rad/s.

    Args:
        noise: noise of motion capture; if small, the pose is known better than `START_COVARIANCE`.
        measured: True if motion capture measured the pose of the resting robot; else it was configured.
    """
    if not measured:
        return START_COVARIANCE
    known = np.array(START_COVARIANCE)
    for k, sigma in enumerate((noise.position_m, noise.position_m, noise.heading_rad)):
        known[k, k] = min(known[k, k], sigma**2 / _REST_SAMPLES + _STANDS**2)
    return known


def _as_decided(start: RunStart, pipeline: ControlPipeline) -> RunStart:
    """The start of a run, with user-supplied parts under their own names."""
    observers = [own_name(one) or name for name, one in pipeline.observers.items()]
    program = "" if pipeline.external is None else pipeline.external.name
    return replace(
        start,
        controller=program or own_name(pipeline.controller) or start.controller,
        feedback=own_name(pipeline.estimator) or start.feedback,
        observers=tuple(observers) or start.observers,
    )
