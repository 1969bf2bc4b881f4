"""Decides after every stop whether the robot is HELD, by checking it until it is or time is up.

"Held" is a measured state, not a sent command: all eight servos report torque and armed watchdogs, the wheels
rest, and no sensor that can measure the robot's motion shows any. Until then the driver keeps the servos
holding (`look_after`).
"""

import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hil.bench.hold.adhesion_force import press_watch, read_whatever_happens
from hil.bench.hold.camera_vote import CAMERA, CameraVote
from hil.bench.hold.check_deadline import HoldCheckDeadline
from hil.bench.hold.felt_weight import FeltWeight
from hil.bench.hold.frame_jumps import FrameJumps
from hil.bench.hold.held_state import Held, State, lacking_in_words, on_the_floor
from hil.bench.hold.motion_since_stop import FEWEST_FOR_NOISE, JOINTS, MotionSinceStop, Trail
from hil.bench.hold.slide_watch import SlideWatch
from hil.bench.hold.tilt_check import TiltWatch
from hil.bench.loop_settings import can_fall
from hil.bench.pipelines import BenchModel
from hil.core.clock import NS_PER_S, Clock, nanoseconds
from hil.core.geometry import Array
from hil.core.interfaces import Sink
from hil.core.registry import base_of, further, kinds
from hil.core.signals import (
    KINDS,
    SERVOS,
    CycleRecord,
    Event,
    ImuSample,
    Inputs,
    RobotState,
    ServoHold,
    Status,
    samples_of,
    worst,
)
from hil.loop.device_set import DeviceSet
from hil.support.lost_time import late_in_words

_LOOK_NS = nanoseconds(0.02)
_SELDOM_NS = nanoseconds(0.05)
"""Sample period while only time has to pass: a window still holds five samples of the servos."""
_SLOW_NS = nanoseconds(1.5)
"""Time limit for an IMU that has begun to deliver: on a busy computer its samples come late."""
_STOPPED_NS = nanoseconds(0.3)
"""Time after a stop by which the wheels rest: what still moves then slides."""
_RISES_NS = nanoseconds(2.0)
"""Time that a fan takes to a higher force: meanwhile a force that falls seems to rise."""
_MOVED_M = 0.001
_UNSEEN_M = 0.005
"""Largest undetected motion of a held robot after its stop."""
_OFTEN = 0.1
"""Share of unanswered reads from which HELD names a servo."""


class HoldMonitor(Sink):
    """Sink that follows the robot's position, and checks the robot after a stop.

    Args:
        model: the bench model. Devices in another world than the servos measure another robot and are not
            read.
        devices: devices of the bench.
        clock: the bench clock.
        tell: called with an event when the check raises fan or propellers.
        show: called while the robot is watched: why it does not count as held yet, and the time for which
            its wheels have been at rest (s; None where they turn, or are not seen).

    Attributes:
        tilt: measured tilt: "on the floor" is accepted only if it does not contradict.
        last_state: estimate of the latest cycle; None before.
    """

    def __init__(
        self,
        model: BenchModel,
        devices: DeviceSet,
        clock: Clock,
        tell: Callable[[Event], None],
        show: Callable[[str, float | None], None],
    ) -> None:
        self._tell, self._show = tell, show
        config, elsewhere = model.config, model.config.elsewhere()
        self.tilt = TiltWatch(config)
        self._press = press_watch(config, devices)
        self._weight = FeltWeight(config.safety.adhesion_limit_m_s2)
        self._devices, self._clock = devices, clock
        present = [k for k in kinds().values() if devices.get(k.name) is not None]
        present += [kinds()[name] for name in further(devices.sensors) if base_of(name) not in KINDS]
        able = {k.name: k for k in present if k.motion_threshold}
        self._seeing = {name: kind for name, kind in able.items() if name not in elsewhere}
        self._blind = [k.noun for name, k in able.items() if name in elsewhere and k.measures_position]
        self._on_wall, self._can_fall = config.environment.on_wall, can_fall(config)
        self._emulated = "servos" in config.emulated()
        self._travel = MotionSinceStop(self._seeing, float(np.mean(model.geometry.radius_m)))
        sources = [(name, self._seeing[name]) for name in self._travel.names]
        self._motion_sources = [(n, samples_of(n), k.motion_value, k.measures_position) for n, k in sources]
        self._doubted: dict[str, bool] = {}
        self._reads, self._unread = 0, Counter[str]()
        self._pressed_ns: int | None = None
        self._moving = self._seen_moving = self._pushed = False
        self._jumps, self._slides = FrameJumps(), SlideWatch(model, self._seeing)
        self._vote = CameraVote()
        self._let_go = False
        self.last_state: RobotState | None = None

    def write(self, record: CycleRecord) -> None:
        """Store the latest positions of the robot."""
        inputs = record.inputs
        pose = record.state.pose_body_in_wall
        heading_rad, estimated = pose.item(2), None
        if math.isfinite(heading_rad):  # the last cycle before a stop has no estimate
            self._press.heading_rad = heading_rad
            self.last_state, estimated = record.state, pose[:2]
        self.tilt.saw(inputs.imu)
        self._slides.drove(record)
        passed, t_ns = self._travel.passed, inputs.t_ns
        for name, among, value_of, is_place in self._motion_sources:
            for sample in among(inputs):
                place = value_of(sample)
                if place is None:
                    continue
                if is_place:
                    self._follow(name, sample, place, estimated)
                passed(name, t_ns, place)

    def passed_over(self, inputs: Inputs) -> None:
        """Process samples from before a run, which no other code uses."""
        self.tilt.saw(inputs.imu)
        for name, among, value_of, is_place in self._motion_sources:
            for sample in among(inputs) if is_place else ():
                place = value_of(sample)
                if place is not None:
                    self._follow(name, sample, place)

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def stopped(self, doubted: Mapping[str, bool] | None = None, agreed: Collection[str] = ()) -> None:
        """Begin to measure the displacement of a robot that was stopped.

        Args:
            doubted: devices whose motion was in doubt, and whether others agreed against them; they are not
                trusted to show rest.
            agreed: devices that agreed with another on the motion; they are trusted again.
        """
        for name in agreed:
            self._doubted.pop(name, None)
            self._vote.decided &= name != CAMERA
        for name, sure in (doubted or {}).items():
            self._doubted[name] = sure or self._doubted.get(name, False)
        self._travel.stopped(self._clock.now_ns())
        self._jumps.run_ended()

    def at_rest(self, left: RobotState) -> RobotState:
        """State at rest after a run; the covariance includes measured and possible unseen motion since."""
        moved_m = self._travel.moved_m(self._believed(self._travel.names), slides=self._on_wall)
        covariance = left.covariance.copy()
        covariance[:2, :2] += max(moved_m or 0.0, _UNSEEN_M) ** 2 * np.eye(2)
        return replace(left, twist_body=np.zeros(3), covariance=covariance, diagnostics={})

    def frame_moved_m(self, name: str) -> float:
        """Detected displacement of the reference frame of a position sensor, m."""
        return self._jumps.size_m(name)

    def look(self, limit_s: float, *, strict: bool = False, for_good: bool = False) -> Held:
        """Keep the servos holding and check the robot until it is held, for `limit_s` at the most.

        With propellers that report nothing the limit is extended until it is known that they keep running,
        unless `strict`. Never raises for a device error: a sensor that fails is left out.

        Args:
            limit_s: time limit.
            strict: True if the limit is never extended; an undecided check gives NOT HELD.
            for_good: True if the bench ends now: no more commands are sent to a held robot.
        """
        held = self._look(limit_s, strict, for_good)
        if not (for_good and held.state == "HELD"):
            self._press.end()
        return held

    def _look(self, limit_s: float, strict: bool, for_good: bool) -> Held:
        servos = self._devices.servos
        if servos is None or not servos.identity():
            return self.unseen("no servos are open", wanted=False)
        began_ns = self._clock.now_ns()
        time = HoldCheckDeadline(began_ns, limit_s, strict=strict)
        trails = {
            name: Trail(kind.motion_threshold, 0 if name == JOINTS else FEWEST_FOR_NOISE)
            for name, kind in self._seeing.items()
        }
        self._press.begin(for_good=for_good)
        self._slides.begin()
        self._vote.begin()
        self._pressed_ns, self._pushed = None, False
        self._weight.begin()
        self._reads, self._unread = 0, Counter()
        self._resting_ns: int | None = None
        self._lost_ns()
        while True:
            hold = servos.look_after()
            time.on_servo_status(hold)
            time.on_lost(self._lost_ns())
            self._see(hold, trails)
            seen = [name for name, trail in trails.items() if trail.full(hold.t_ns)]
            places = self._places(seen)
            doubt = self._doubt(hold, trails, seen, places)
            moves = bool(places and self._moving and not hold.trouble)
            unpressed = self._press.doubt(
                self._clock.now_ns(), sees_slide=bool(places) and not doubt, moves=moves
            )
            now_ns = self._clock.now_ns()
            self._press_harder(now_ns, began_ns)
            rises = self._pressed_ns is not None and now_ns - self._pressed_ns < _RISES_NS
            time.on_observation(hold.t_ns, doubt=bool(doubt), waits=self._press.waits or rises)
            doubt = doubt or unpressed or self._doubt_of_floor()
            if rises:
                doubt = doubt or "the fan has just been raised: what it gives then has not been seen yet"
            # wait no longer than this for sensors that have begun to deliver
            early = hold.t_ns - began_ns < 2 * max(trail.window_ns for trail in trails.values())
            slow = self.tilt.begun and hold.t_ns - began_ns < _SLOW_NS
            unsure = (early or slow) and not self._on_wall and not self.tilt.known
            if unsure or (early and any(trail.fills(hold.t_ns) for trail in trails.values())):
                doubt = doubt or "not all that see the robot have seen it for long enough"
            self._show(doubt, self._rest_s(hold, trails[JOINTS], known=JOINTS in seen))
            if not hold.wanted and not unsure:
                why = f"torque was {'switched off' if hold.released else 'never switched on'}"
                return self._verdict("NOT HELD", why, seen, wanted=hold.released and not self._let_go)
            late = "".join(f"; {name} ({text})" for name, text in hold.late.items())
            if not doubt:
                return self._verdict("HELD", self._grounds(hold.t_ns, seen, places) + late, seen)
            if time.is_up(self._clock.now_ns()):
                busy = late_in_words(time.lost_ns, "this check, or from emulated devices")
                return self._verdict("NOT HELD", doubt + late + f"; meanwhile {busy}" * bool(busy), seen)
            calm = self._press.waits and JOINTS in seen and not hold.trouble
            pause_ns = _SELDOM_NS if calm else _LOOK_NS
            self._clock.sleep_until_ns(self._clock.now_ns() + pause_ns)

    def _rest_s(self, hold: ServoHold, joints: Trail, *, known: bool) -> float | None:
        """Time for which the joints have not moved, s; None where they move, or are not seen."""
        if not known or joints.moves():
            self._resting_ns = None
        elif self._resting_ns is None:
            self._resting_ns = hold.t_ns - joints.window_ns
        return None if self._resting_ns is None else (hold.t_ns - self._resting_ns) / NS_PER_S

    def _lost_ns(self) -> int:
        """Time that this computer has lost since the last call, ns."""
        return 0 if self._devices.lost is None else sum(self._devices.lost.take().values())

    def _press_harder(self, now_ns: int, began_ns: int) -> None:
        """Raise the fan, once a check, if the force is too small or the robot slides after it has stopped.

        The propellers are set against a slide that two sensors show.
        """
        along_m = self._slides.along_m
        slides = bool(along_m) or (self._seen_moving and now_ns - began_ns > _STOPPED_NS)
        if self._can_fall and self._pressed_ns is None and (slides or self._press.lacks):
            self._pressed_ns = now_ns
            self._devices.brace()
            why = "the robot still moves" if slides else "the measured force is too small, or falls"
            fan = "no fan can be raised" if self._devices.get("adhesion") is None else "the fan is raised"
            self._tell(Event(now_ns, "warning", "bench", f"{why} after the stop: {fan}"))
        push = self._press.push_against(along_m) if self._can_fall else None
        if push is None:
            return
        refused = self._devices.push(push, falls=self._weight.falls())
        if not (self._pushed or refused):
            self._pushed = True
            said = f"the robot slides after the stop: the propellers are set to {push.force_n:.1f} N"
            self._tell(Event(now_ns, "warning", "bench", said))

    def _grounds(self, t_ns: int, seen: Collection[str], places: Collection[str]) -> str:
        """Text with the evidence that the robot is held."""
        by = {*self._believed(seen), *places}
        rests = ", ".join(kinds()[name].noun for name in seen if name in by)
        tether = self._on_wall and not (self._can_fall or places or self._press.feels(t_ns))
        by_tether = "; on its tether, so no sensor has to see whether it slides" if tether else ""
        pressed, outvoted = self._press.in_words(t_ns), self._vote.in_words()
        return f"torque on, at rest by {rests}{pressed}{by_tether}{outvoted}{self._missed()}"

    def _missed(self) -> str:
        """Text with the servos that missed many reads of this check; empty for none."""
        most = max(self._unread.values(), default=0)
        often = {n for n, lost in self._unread.items() if lost > _OFTEN * self._reads and 2 * lost > most}
        who = "all eight servos" if len(often) == len(SERVOS) else ", ".join(n for n in SERVOS if n in often)
        return f"; {who} did not answer {most} of {self._reads} reads" if often else ""

    def _believed(self, seen: Collection[str]) -> list[str]:
        """Sensors that have measured the robot and were not in doubt."""
        return [name for name in seen if name == JOINTS or name not in self._doubted]

    def _places(self, seen: Collection[str]) -> list[str]:
        """Trusted sensors that would detect a slide.

        Of two that contradicted each other one is right: when both show rest, the robot rests.
        """
        places = [name for name in seen if self._seeing[name].measures_position]
        undecided = [name for name in places if not self._doubted.get(name)]
        return self._believed(places) or (undecided if len(undecided) > 1 else [])

    def _verdict(self, state: State, why: str, seen: Collection[str] = (), *, wanted: bool = True) -> Held:
        moved_m = self._travel.moved_m(self._believed(seen), slides=self._on_wall)
        if moved_m is None and state == "NOT HELD":  # if it is lost: its last measured displacement
            last_m = self._travel.moved_m(self._believed(self._travel.names), slides=self._on_wall)
            moved_m = last_m if last_m is not None and last_m > _MOVED_M else None
        if rolled_m := self._travel.outvoted_m(self._believed(seen)):
            way = f"{1e3 * rolled_m:.1f} mm since the stop"
            why += f"; the servos show {way} and do not count: their data are old, or the wheels slip"
        if state == "HELD" and moved_m is None:
            why += "; how far it has moved since the stop was not measured"
        no_floor = self._doubt_of_floor()
        if no_floor and no_floor not in why:
            why += f"; {no_floor}"
        if not (self._on_wall or no_floor):
            known = self.tilt.measured
            by, keys = "IMU" if known else "", ("environment.tilt_rad",)
            return on_the_floor(Held(state, moved_m, why, wanted, by=by, confirmed=known, rests_on=keys))
        by, confirmed, rests_on = self._press.basis(self._clock.now_ns())
        return Held(state, moved_m, why, wanted, by=by, confirmed=confirmed, rests_on=rests_on)

    def let_go(self) -> None:
        """Note that torque is about to be released on purpose, so that torque off is not a loss."""
        self._let_go = True

    def released(self) -> Held:
        """The result for a robot whose torque was released on purpose."""
        return self._verdict("NOT HELD", "torque was released, as exit.policy asks", wanted=False)

    def unseen(self, why: str, *, wanted: bool = True) -> Held:
        """The result for a robot that could not be checked, or not yet."""
        return replace(self._verdict("NOT HELD", f"not checked: {why}", wanted=wanted), moved_m=None)

    def _see(self, hold: ServoHold, trails: dict[str, Trail]) -> None:
        """Add the new samples of servos and sensors to the trails."""
        now_ns, read = hold.t_ns, np.isfinite(hold.position_rad)
        self._reads += 1
        self._unread.update(name for name, known in zip(SERVOS, read, strict=True) if not known)
        seen = [(JOINTS, hold.position_rad)] if read.all() else []
        samples = {n: read_whatever_happens(self._devices, n) for n in self._seeing if n != JOINTS}
        for name, some in samples.items():
            seen += [(name, value) for value in self._motion_values(name, some)]
        self._slides.saw(hold, samples)
        for name, value in seen:
            trails[name].add(now_ns, value)
            if name in self._travel.names:
                self._travel.saw(name, now_ns, value)
        for trail in trails.values():
            trail.forget(now_ns - trail.window_ns)

    def _motion_values(self, name: str, samples: Sequence[Any]) -> list[Array]:
        """Motion values of a sensor's samples."""
        for sample in samples:
            if isinstance(sample, ImuSample) and sample.status is Status.OK:
                self._weight.felt(sample)
                self.tilt.saw((sample,))
            if name in self._travel.names and worst(sample) is Status.RESET:
                self._travel.begins_anew(name)
                self._jumps.begins_anew(name)
        values = [(sample, self._seeing[name].motion_value(sample)) for sample in samples]
        for sample, value in values:
            if value is not None and self._seeing[name].measures_position:
                self._follow(name, sample, value)
        return [value for _, value in values if value is not None]

    def _follow(self, name: str, sample: Any, place: Array, estimated: Array | None = None) -> None:
        """Process a position; a jump of the sensor's frame restarts its displacement."""
        for moved in self._jumps.follow(name, sample.stamp.t_ns, place, estimated):
            self._travel.begins_anew(moved)

    def _doubt(
        self, hold: ServoHold, trails: dict[str, Trail], seen: Collection[str], places: Collection[str]
    ) -> str:
        """Why the robot is not held, by servos and motion; empty for no reason.

        Args:
            hold: status of the servos.
            trails: recent motion values, by sensor.
            seen: sensors that have measured the robot for long enough.
            places: those of them that would detect a slide, and are trusted.
        """
        felt = self._weight.doubt()
        self._moving, self._seen_moving = bool(felt), False
        if hold.trouble or felt:
            servos = lacking_in_words(hold, emulated=self._emulated) if hold.trouble else "torque is on"
            return "; ".join([felt, servos] if felt else [servos])
        if JOINTS not in seen:
            some = len(self._unread) < len(SERVOS) and ", ".join(sorted(self._unread))
            who = f"{some} did not answer each time, so that they" if some else "the servos"
            return f"torque is on, but {who} have not been seen at rest for long enough"
        moving = [name for name in seen if not self._doubted.get(name) and trails[name].moves()]
        confirmed = self._press.basis(self._clock.now_ns())[1]
        if self._vote.follow(hold.t_ns, moving, places, confirmed=confirmed):
            self._doubted[CAMERA] = True
        if moving:
            self._moving, self._seen_moving = True, moving[0] in places
            return f"torque is on, but the robot still moves by its {kinds()[moving[0]].noun}"
        if len(self._seeing) > 1 and not any(n != JOINTS and not self._doubted.get(n) for n in seen):
            return "torque is on, but no camera, motion capture or IMU confirms that it stands still"
        if not self._can_fall or places or self._press.feels(hold.t_ns):
            return ""
        return self._slide_unseen(seen)

    def _doubt_of_floor(self) -> str:
        """Why the IMU contradicts the configured floor or tilt; empty if it does not."""
        steeper = self.tilt.steeper()
        return f"{steeper}: secure the robot, and correct environment.tilt_rad" if steeper else ""

    def _slide_unseen(self, seen: Collection[str]) -> str:
        """Message that no sensor would detect a slide: that takes a position or force sensor."""
        doubted = [kinds()[name].noun for name in seen if self._seeing[name].measures_position]
        why = f" (what the {' and the '.join(doubted)} said before the stop is in doubt)" if doubted else ""
        if self._blind:
            why += f" ({', '.join(self._blind)}: in another world than the servos, blind to this robot)"
        return (
            f"torque is on, but no sensor can see whether the robot slides{why}: that takes a camera, motion "
            "capture or load cells; secure the robot"
        )
