"""Whether the robot is held: somebody looks after every stop, until it is true or time is up.

"Held" is a claim about the world, not about what was sent: all eight servos say that they have torque and
that their watchdogs wait, the wheels rest, and nothing that can see the robot sees it move. Until then the
servos go on being looked after.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from hil.bench.pressing import PressWatch
from hil.ring.rig import Rig
from hil.vocabulary.clock import Clock, nanoseconds
from hil.vocabulary.errors import HilError
from hil.vocabulary.geometry import Array
from hil.vocabulary.interfaces import Sink
from hil.vocabulary.kinds import kinds
from hil.vocabulary.signals import SERVOS, CycleRecord, ImuSample, ServoHold, Status

_LOOK_NS = nanoseconds(0.02)
_WINDOW_NS = nanoseconds(0.2)
_LEAST = 4
_SERVOS = "servos"
_FRESH_NS = nanoseconds(0.05)
_MEAN_OF = 5
"""Sightings that are averaged against a camera's noise: 25 ms of it."""
State = Literal["HELD", "NOT HELD", "not needed"]


@dataclass(frozen=True)
class Held:
    """How a run left the robot.

    Attributes:
        state: `not needed` where gravity does not pull along the surface.
        moved_m: farthest that camera, motion capture or wheels say that it went since it was stopped; None
            where it was not measured.
        why: what confirms it; or what is missing, and what is left to do.
        wanted: whether the servos were asked to hold it, and not told to let go.
    """

    state: State
    moved_m: float | None
    why: str
    wanted: bool = True

    def to_json(self) -> dict[str, object]:
        """As in `result.json` and the summary of the live loop."""
        return {"state": self.state, "moved_m": self.moved_m, "why": self.why}

    def __str__(self) -> str:
        return held_in_words(self.to_json())


def held_in_words(held: Mapping[str, Any]) -> str:
    """One line of what `Held.to_json` says."""
    if held["moved_m"] is None:
        looked = "" if held["state"] == "not needed" else "nobody looked: "
        return f"{held['state']}: {looked}{held['why']}"
    return f"{held['state']}: moved {1e3 * held['moved_m']:.1f} mm since the stop; {held['why']}"


def seen_in_words(held: Held) -> str:
    """One line of a look at a robot that nobody has set in motion yet."""
    return f"{held.state}: {held.why}"


def untouched(why: str) -> Held:
    """Of a robot whose devices were never opened: nothing has been done after which it must be held."""
    return Held("not needed", None, why, wanted=False)


class _Trail:
    """Where one witness has seen the robot within the latest window."""

    def __init__(self) -> None:
        self._seen: deque[tuple[int, Array]] = deque()

    def add(self, t_ns: int, place: Array) -> None:
        """Take a sighting."""
        self._seen.append((t_ns, place))

    def forget(self, before_ns: int) -> None:
        """Drop what is older, but for the last of it: the window is to be full."""
        while len(self._seen) > 1 and self._seen[1][0] <= before_ns:
            self._seen.popleft()

    def full(self, now_ns: int) -> bool:
        """Whether it reaches back for a window, and is not out of date."""
        seen = self._seen
        return (
            len(seen) >= _LEAST
            and seen[0][0] <= now_ns - _WINDOW_NS
            and seen[-1][0] >= now_ns - _WINDOW_NS // 2
        )

    def change(self) -> Array:
        """How the place has changed, from the mean of the first quarter to that of the last."""
        places = np.array([place for _, place in self._seen])
        quarter = max(1, len(places) // 4)
        change: Array = places[-quarter:].mean(axis=0) - places[:quarter].mean(axis=0)
        return change


class HoldWatch(Sink):
    """Sees the robot's cycles go by, so that it knows where the robot stood when it was stopped.

    Args:
        rig: devices of the bench.
        clock: the bench clock.
        press: of what presses it on its wall.
        radius_m: of the wheels, to turn their angles into a way.
        on_wall: whether the robot has to be held at all.
        lightest_m_s2: specific force below which it is falling.
    """

    def __init__(
        self,
        rig: Rig,
        clock: Clock,
        press: PressWatch,
        *,
        radius_m: float,
        on_wall: bool,
        lightest_m_s2: float,
    ) -> None:
        self._press = press
        self._lightest_m_s2, self._falls = lightest_m_s2, False
        self._rig, self._clock = rig, clock
        present = [k for k in kinds().values() if rig.get(k.name) is not None]
        self._witnesses = {k.name: k.witness for k in present if k.witness is not None}
        self._radius_m, self._on_wall = radius_m, on_wall
        self._latest: dict[str, deque[tuple[int, Array]]] = {
            name: deque(maxlen=_MEAN_OF)
            for name, witness in self._witnesses.items()
            if witness.is_place or name == _SERVOS
        }
        self._stopped_at: dict[str, Array] = {}
        self._moved_m = 0.0

    def write(self, record: CycleRecord) -> None:
        """Remember where the robot was seen last."""
        inputs = record.inputs
        heading_rad = float(record.state.pose_body_in_wall[2])
        if math.isfinite(heading_rad):  # the last cycle before a stop has no estimate
            self._press.heading_rad = heading_rad
        for name, latest in self._latest.items():
            for sample in inputs.of(name):
                place = self._witnesses[name].value(sample)
                if place is not None:
                    latest.append((inputs.t_ns, place))

    def close(self) -> None:
        """Nothing to let go of."""

    def stopped(self) -> None:
        """The robot has been stopped: what it moves from here on counts, by whoever has just seen it."""
        fresh_ns = self._clock.now_ns() - _FRESH_NS
        latest = self._latest.items()
        self._stopped_at = {name: _mean(seen) for name, seen in latest if seen and seen[-1][0] >= fresh_ns}
        for seen in self._latest.values():
            seen.clear()
        self._moved_m = 0.0

    def look(self, limit_s: float) -> Held:
        """Look after the robot until it is held, for `limit_s` at the most.

        Never raises for what a device does: a sensor that fails is a witness less.
        """
        servos = self._rig.servos
        if servos is None or not servos.identity():
            return self.unseen("no servos are open", wanted=False)
        end_ns = self._clock.now_ns() + nanoseconds(limit_s)
        trails = {name: _Trail() for name in self._witnesses}
        self._press.begin()
        while True:
            hold = servos.look_after()
            self._see(hold, trails)
            pressed = self._press.doubt(self._clock.now_ns())
            doubt = self._doubt(hold, trails) or pressed
            if not hold.wanted:
                return self._verdict("NOT HELD", "torque was never switched on", wanted=False)
            if not doubt:
                return self._verdict("HELD", "torque on, at rest by " + _witnesses(trails, hold.t_ns))
            if self._clock.now_ns() >= end_ns:
                return self._verdict("NOT HELD", doubt)
            self._clock.sleep_until_ns(self._clock.now_ns() + _LOOK_NS)

    def _verdict(self, state: State, why: str, *, wanted: bool = True) -> Held:
        if not self._on_wall:
            state, why = "not needed", f"on the floor; {why}"
        return Held(state, self._moved_m, why, wanted)

    def released(self) -> Held:
        """The robot has been let go of on purpose."""
        return self._verdict("NOT HELD", "torque was released, as exit.policy asks", wanted=False)

    def unseen(self, why: str, *, wanted: bool = True) -> Held:
        """Nobody could look, or has not yet."""
        return replace(self._verdict("NOT HELD", why, wanted=wanted), moved_m=None)

    def _see(self, hold: ServoHold, trails: dict[str, _Trail]) -> None:
        """Take what servos and sensors say now."""
        now_ns = hold.t_ns
        seen = [(_SERVOS, hold.position_rad)] if np.isfinite(hold.position_rad).all() else []
        for name in self._witnesses:
            if name != _SERVOS:
                seen += [(name, value) for value in self._testified(name)]
        for name, value in seen:
            trails[name].add(now_ns, value)
            if name in self._latest:
                self._latest[name].append((now_ns, value))
                self._measure(name)
        for trail in trails.values():
            trail.forget(now_ns - _WINDOW_NS)

    def _testified(self, name: str) -> list[Array]:
        """What a sensor has seen since it was last asked; nothing where it fails."""
        try:
            samples = self._rig.get(name).read()
        except HilError:
            return []
        for sample in samples:
            if isinstance(sample, ImuSample) and sample.status is Status.OK:
                force = sample.gravity_m_s2 + sample.linear_acceleration_m_s2
                self._falls = float(np.linalg.norm(force)) < self._lightest_m_s2
        values = (self._witnesses[name].value(sample) for sample in samples)
        return [value for value in values if value is not None]

    def _measure(self, name: str) -> None:
        """How far a witness says that the robot is from where it was stopped."""
        here = _mean(self._latest[name])
        moved = here - self._stopped_at.setdefault(name, here)
        if name == _SERVOS:
            moved_m = self._radius_m * float(np.median(np.abs(moved[:4])))
        else:
            moved_m = float(np.linalg.norm(moved))
        self._moved_m = max(self._moved_m, moved_m)

    def _doubt(self, hold: ServoHold, trails: dict[str, _Trail]) -> str:
        """What speaks against calling the robot held; empty when nothing does."""
        if hold.trouble or self._falls:
            fallen = ["the accelerometer feels less than the weight: adhesion is lost"] * self._falls
            servos = _in_words(hold) if hold.trouble else "torque is on"
            return "; ".join([*fallen, servos])
        seen = [name for name, trail in trails.items() if trail.full(hold.t_ns)]
        if _SERVOS not in seen:
            return "torque is on, but the servos have not been seen at rest for long enough"
        for name in seen:
            change = float(np.abs(trails[name].change()).max())
            if change > self._witnesses[name].still:
                return f"torque is on, but the robot still moves by its {kinds()[name].noun}"
        if len(seen) == 1 and len(self._witnesses) > 1:
            return "torque is on, but no camera, motion capture or IMU confirms that it stands still"
        return ""


def _mean(seen: deque[tuple[int, Array]]) -> Array:
    place: Array = np.mean([place for _, place in seen], axis=0)
    return place


def _witnesses(trails: dict[str, _Trail], now_ns: int) -> str:
    return ", ".join(kinds()[name].noun for name, trail in trails.items() if trail.full(now_ns))


def _in_words(hold: ServoHold) -> str:
    """What the servos lack, and what is left to do about it."""
    silent = [text for text in hold.trouble.values() if Status.TIMEOUT.value in text]
    if len(silent) == len(SERVOS):
        found = "no servo answers: check the servos' supply, the bus and its adapter"
    else:
        found = ", ".join(f"{name} ({text})" for name, text in hold.trouble.items())
    return f"{found}; torque comes back with the servos only while this program runs: secure the robot"
