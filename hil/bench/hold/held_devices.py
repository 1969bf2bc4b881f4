"""Opens and closes devices and sinks of a bench together, and keeps the robot held in every case."""

import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from types import TracebackType
from typing import TypeVar

from hil.bench.camera_odometry import wheel_feed
from hil.bench.cross_checks.parameters import Parameters
from hil.bench.hold.force_schedule import by_need
from hil.bench.hold.held_state import Held, untouched
from hil.bench.hold.hold_check import HoldMonitor
from hil.bench.hold.preload import Preload
from hil.bench.injection import Injection, real_device
from hil.bench.loop_settings import can_fall, fail_limits
from hil.bench.pipelines import BenchModel
from hil.bench.reconnect import reconnecting
from hil.bench.seen_events import SeenEvents
from hil.bench.unreached_faults import ended_before, not_begun, not_met_in_words
from hil.core.clock import Clock
from hil.core.errors import SafetyStop, UsageError, check_number
from hil.core.interfaces import HELD_NOTE, Sink
from hil.core.watched_robot import WatchedRobot
from hil.faults.fault import Fault
from hil.loop.device_set import DeviceSet
from hil.recording.clock_offsets import ptp_offsets
from hil.recording.transform_tree import describe_clock
from hil.robot.trajectories import Trajectory

LOG = logging.getLogger(__name__)
_LOOK_S = 1.0
Opened = TypeVar("Opened", bound="HeldDevices")


class HeldDevices:
    """The part of `Bench` that opens, holds and closes; its attributes are described there."""

    def __init__(
        self,
        model: BenchModel,
        clock: Clock,
        devices: DeviceSet,
        *,
        sinks: tuple[Sink, ...],
        faults: tuple[Fault, ...],
        injection: Injection | None = None,
    ) -> None:
        self.model, self.clock, self.devices = model, clock, devices
        self.config, self.geometry = model.config, model.geometry
        self.seed, self.calibration = model.seed, model.calibration
        self.parameters = Parameters(model.config)
        self.held = untouched("no device was opened: the robot is as it was before")
        self.warns_not_held = True
        self.waits_for_sensors = False
        self.lost: list[str] = []
        self.faults = faults
        self.injection = Injection(self.config, clock) if injection is None else injection
        self.injection.follow(lambda: self.world_ns)
        devices.disarm = self.injection.disarm
        self._is_open = False
        self.stopped_by = ""
        self._begun_ns: int | None = None
        self._clock_description: dict[str, object] | None = None
        self._open_ns: int | None = None
        self._closed_ns: int | None = None
        self._looked_ns: int | None = None
        self.pressed = ""
        self.seen = SeenEvents(self._since_begun_ns)
        self._hold = HoldMonitor(model, devices, clock, self.seen.add, self._show_watched)
        self._sinks = [*sinks, self.seen]
        self._stack = ExitStack()
        self._before_opening: list[Callable[[], object]] = []

    def __enter__(self: Opened) -> Opened:
        try:
            self.begin()
            limits = None if self.waits_for_sensors else fail_limits(self.config)
            self.devices.sensors = reconnecting(self.devices.sensors, self.clock, limits)
            self.devices.open()
        except BaseException as error:
            self.held = self._hold.unseen(f"the bench did not open ({type(error).__name__})")
            self._let_go()
            raise
        self._stack.callback(self.devices.close)
        self._is_open = True
        self._not_looked_at("the bench is open, and bench.look() was not called")
        try:
            self.pressed = Preload(self.config, self.devices, self.clock).hold()
            self._sinks += [*self.injection.sinks()]
            self._sinks += [*by_need(self.config, self.devices), *wheel_feed(self.model, self.devices)]
            if self.on_wall and self.devices.servos is not None:
                self.devices.servos.enable()
            self._open_ns = self.clock.now_ns()
        except BaseException as error:
            if isinstance(error, SafetyStop):
                self.parameters.stopped(error.reason, str(error))
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Hold the robot and check it until it is held (or release it, as configured); close everything.

        The final `held` is also recorded. Idempotent.
        """
        if self._closed_ns is None:
            self._closed_ns = self.clock.now_ns()
        self.injection.disarm()
        try:
            if self.devices.servos is not None and self.devices.servos.identity():
                self.held = self._hold.unseen("ended before the hold was checked")
                self.devices.servos.stop()
                self.held = self._hold.look(self.config.exit.look_after_s, for_good=True)
                if self.config.exit.policy == "release" and not self._steeper():
                    self.devices.servos.release()
                    self.held = self._hold.released()
                self._looked_ns = self.clock.now_ns()
                self._note(self._looked_ns, HELD_NOTE, self.held.to_json())
                if self.warns_not_held and self.held.lost:
                    LOG.warning("bench %s: the robot is left %s", self.config.name, self.held)
        finally:
            self._let_go()

    @property
    def is_open(self) -> bool:
        """Whether the bench has been entered and is not closed yet."""
        return self._is_open

    def must_be_open(self) -> None:
        """Raise `UsageError` before the bench is entered, and once it is closed."""
        if not self._is_open:
            raise UsageError(
                "the bench is not open" if self._closed_ns is None else "the bench is closed",
                remedy="use `with hil.open_bench(...) as bench:`, and the bench within that block",
            )

    def _let_go(self) -> None:
        self._is_open = False
        self._close_sinks()
        self._stack.close()

    def on_open(self, callback: Callable[[], object]) -> None:
        """Register a callback that is called right before the devices are opened."""
        self._before_opening.append(callback)

    def begin(self) -> None:
        """Start the world of served emulated devices, for callers that open devices singly. Idempotent."""
        while self._before_opening:
            self._before_opening.pop(0)()
        if self._begun_ns is None:
            self._begun_ns = self.clock.now_ns()

    @property
    def world_ns(self) -> int:
        """Time of the emulated world, by which faults begin; stops when the bench is closed."""
        return self._since_begun_ns(self._closed_ns)

    @property
    def looked_ns(self) -> int:
        """World time at the end of the check of the stopped robot; never less than `world_ns`."""
        return self._since_begun_ns(self._closed_ns if self._looked_ns is None else self._looked_ns)

    def _since_begun_ns(self, t_ns: int | None) -> int:
        if self._begun_ns is None:
            return 0
        return (self.clock.now_ns() if t_ns is None else t_ns) - self._begun_ns

    @property
    def first_cycle_ns(self) -> int:
        """World time of the first cycle; 0 before it."""
        return 0 if self.seen.first_ns is None else self._since_begun_ns(self.seen.first_ns)

    def faults_without_effect(self) -> tuple[Fault, ...]:
        """Faults in front of real devices that have begun and hit no message."""
        return self.injection.without_effect()

    def faults_not_met(self) -> tuple[Fault, ...]:
        """Planned faults that met no control cycle.

        They had not begun when the bench was closed; or, at emulated devices, they ended before the first
        cycle and did not act while their device was opened.
        """
        return not_begun(self.faults, self.world_ns) + self.faults_too_early()

    def faults_too_early(self) -> tuple[Fault, ...]:
        """Those of `faults_not_met` that ended before the first cycle; none if there was no cycle."""
        if self.seen.first_ns is None:
            return ()
        since = self._since_begun_ns
        opening = {name: (since(a), since(b)) for name, (a, b) in self.devices.opening_ns.items()}
        own = [fault for fault in self.faults if not real_device(self.config, fault)]
        return ended_before(own, self.first_cycle_ns, opening, since(self._open_ns))

    def not_met_in_words(self, faults: Sequence[Fault]) -> str:
        """One line about some of `faults_not_met`."""
        return not_met_in_words(faults, self.world_ns, self.looked_ns, self.first_cycle_ns)

    def on_close(self, callback: Callable[[], object]) -> None:
        """Register a callback that is called when the bench closes, after the devices."""
        self._stack.callback(callback)

    def add_sink(self, sink: Sink) -> None:
        """Add a sink that receives every cycle from now on; the bench closes it."""
        self._sinks.append(sink)

    def remove_sink(self, sink: Sink) -> None:
        """Remove a sink and close it."""
        self._sinks.remove(sink)
        sink.close()

    def _close_sinks(self) -> None:
        for sink in self._sinks:
            self.devices.aside.call(type(sink).__name__, sink.close)
        self._sinks.clear()

    def check(self, trajectory: Trajectory, *, known: Trajectory | None = None) -> None:
        """Refuse a trajectory that exceeds the limits.

        Args:
            trajectory: the requested trajectory.
            known: a trajectory that was checked before; common segments at the end are not checked again.

        Raises:
            TrajectoryError: the trajectory exceeds a limit; names the first time at which it does.
            UsageError: `trajectory` is not a trajectory, or leads a robot on a wall too far for a fault that
                is injected in front of one of its devices.
        """
        self.model.check(trajectory, known=known)
        self.injection.check(trajectory)

    def header(self) -> dict[str, object]:
        """Header of the model, and the offset of the clock to the time of day at the first call.

        All recordings of a bench, and its published messages, use the same offset for their stamps.
        """
        if self._clock_description is None:
            wall = self.clock.wall_offset()
            ptp = [] if wall is None else [one._asdict() for one in ptp_offsets(self.clock.now_ns)]
            self._clock_description = describe_clock(wall, ptp)
        return {**self.model.header(), "clock": self._clock_description}

    def _note(self, t_ns: int, kind: str, data: Mapping[str, object]) -> None:
        """Send a note between two cycles to all sinks."""
        for sink in self._sinks:
            self.devices.aside.call(type(sink).__name__, partial(sink.note, t_ns, kind, data))

    def _show_watched(self, doubt: str, rest_s: float | None) -> None:
        """Pass on to all sinks what is seen of the robot while it is watched."""
        seen = WatchedRobot(self.stopped_by, doubt, rest_s)
        for sink in self._sinks:
            self.devices.aside.call(type(sink).__name__, partial(sink.watched, seen))

    def has(self, name: str) -> bool:
        """Whether the bench has a device of this kind."""
        return self.devices.get(name) is not None

    def _steeper(self) -> str:
        """Why an untethered robot must not be released although the bench file has a floor; else empty."""
        return "" if self.config.safety.tethered else self._hold.tilt.steeper()

    @property
    def on_wall(self) -> bool:
        """Whether gravity acts along the surface, so that the robot has to be held."""
        return self.config.environment.on_wall

    def look(self, limit_s: float | None = None) -> Held:
        """Check a stopped robot until it is held or the time limit is reached; sets `held` to the result.

        Args:
            limit_s: time limit. By default 1 s, plus the time (seconds) that propellers without reports need
                to let a robot slide. An undecided check gives NOT HELD.

        Raises:
            UsageError: the limit is below 0 or not a number.
        """
        if limit_s is not None:
            check_number(limit_s, "limit_s", "s")
        self.injection.disarm()
        self.held = self._hold.look(_LOOK_S if limit_s is None else limit_s, strict=limit_s is not None)
        return self.held

    def _not_looked_at(self, why: str) -> None:
        """Set `held` for a robot that was not checked since its devices were opened or driven."""
        if self.devices.servos is None:
            self.held = untouched("the bench has no servos: the robot is as it was before")
        else:
            self.held = self._hold.unseen(why, wanted=False)

    def stop(self) -> None:
        """Command wheels at rest, steering held, torque on; `look` checks the result."""
        self.devices.actuators().stop()

    def release(self) -> None:
        """Switch torque off: on a wall the robot slides.

        Raises:
            UsageError: the robot hangs on a wall by its fan, and `safety.tethered` is not set; or the IMU
                shows a wall where the bench file has none.
        """
        if steeper := self._steeper():
            raise UsageError(
                f"torque is not released: {steeper}",
                expected="a robot off the wall, or on a tether",
                remedy="correct environment.tilt_rad, or secure the robot and set safety.tethered = true",
            )
        if can_fall(self.config) and self.has("adhesion"):
            raise UsageError(
                "torque is not released: the robot hangs on a wall",
                expected="a robot off the wall, or on a tether",
                remedy="take it off the wall, or secure it and set safety.tethered = true",
            )
        self._hold.let_go()
        self._not_looked_at("torque was released")
        self.devices.actuators().release()
