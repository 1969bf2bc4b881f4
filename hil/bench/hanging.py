"""Presses the robot on its wall before anything moves: fan and propellers on, force measured, then servos."""

from __future__ import annotations

import math
from typing import Any

from hil.bench.settings import adhesion_limits, force_wanted_n, thrust_wanted_n
from hil.config.bench import BenchConfig
from hil.ring.adhesion import AdhesionLimits, apart
from hil.ring.rig import Rig
from hil.vocabulary.clock import Clock, nanoseconds
from hil.vocabulary.errors import DeviceError, SafetyStop
from hil.vocabulary.signals import Status

_STEP_NS = nanoseconds(0.01)
_PATIENCE_NS = nanoseconds(12.0)
_STEADY_NS = nanoseconds(0.1)
_TETHERED_SHARE = 0.9
_NO_SAMPLE_NS = nanoseconds(1.0)


class Hanging:
    """Fan and propellers of a bench on a wall.

    Args:
        config: of the bench.
        rig: its devices, open.
        clock: the bench clock.
    """

    def __init__(self, config: BenchConfig, rig: Rig, clock: Clock) -> None:
        self._config, self._rig, self._clock = config, rig, clock
        self._limits = adhesion_limits(config)
        self._seen_n: dict[str, float] = {}

    def hold(self) -> str:
        """Ask for the working forces, and wait until the robot is pressed firmly enough.

        Does nothing where the bench has nothing that holds the robot, or the robot is on the floor.

        Returns:
            What was measured, in words; empty where nothing was done.

        Raises:
            SafetyStop: `adhesion`: the force stays below the limit of this surface; `adhesion_disagree`:
                those who measure it contradict each other. Nothing has moved, and the fan goes on.
            DeviceError: a device fails.
        """
        limits = self._limits
        if limits is None or not self._config.environment.on_wall:
            return ""
        thrust_n = thrust_wanted_n(self._config)
        if (propellers := self._rig.get("thrust")) is not None:
            propellers.set_force_n(thrust_n)
        self._ask_fan()
        limit_n = self._wait(limits, thrust_n)
        self._compare()
        return f"Pressed on the wall with {self._told()}; {limit_n:.1f} N are the least on this surface."

    def _ask_fan(self) -> None:
        """Tell the keeper, as soon as it has heard the fan."""
        fan = self._rig.get("adhesion")
        if fan is None:
            return
        end_ns = self._clock.now_ns() + _NO_SAMPLE_NS
        while True:
            self._look()
            try:
                fan.set_force_n(force_wanted_n(self._config))
                return
            except DeviceError:
                if self._clock.now_ns() >= end_ns:
                    raise
            self._clock.sleep_until_ns(self._clock.now_ns() + _STEP_NS)

    def _compare(self) -> None:
        """Cells and speed have to agree before anything hangs by them."""
        found = list(self._seen_n.values())
        if len(found) == 2 and apart(found[0], found[1]):
            raise SafetyStop(
                "adhesion_disagree",
                f"nothing has moved, and those who measure the force disagree: {self._told()}; look at "
                "load_cells.zero_n, adhesion.rated_force_n and the seal, and run adhesion_check",
            )

    def _told(self) -> str:
        return ", ".join(f"{force:.1f} N by {name}" for name, force in self._seen_n.items())

    def _wait(self, limits: AdhesionLimits, thrust_n: float) -> float:
        """Wait for the force; returns its limit."""
        limit_n = limits.limit_n(thrust_n, self._config.environment.start_pose[2])
        if self._config.safety.tethered:
            limit_n = min(limit_n, _TETHERED_SHARE * force_wanted_n(self._config))
        steady_ns: int | None = None
        end_ns = self._clock.now_ns() + _PATIENCE_NS
        while (now_ns := self._clock.now_ns()) < end_ns:
            force_n = self._look()
            if force_n < limit_n or not math.isfinite(force_n):
                steady_ns = None
            elif steady_ns is None:
                steady_ns = now_ns
            steady = steady_ns is not None and now_ns - steady_ns >= _STEADY_NS
            if steady or (steady_ns is not None and force_n >= self._enough(limit_n)):
                return limit_n
            self._clock.sleep_until_ns(now_ns + _STEP_NS)
        told = self._told() or "nothing measured"
        raise SafetyStop(
            "adhesion",
            f"the robot is not pressed on the wall: {told}; {limit_n:.1f} N are the least on this surface. "
            "Nothing has moved; look at fan, battery, seal and load cells (`hil doctor`)",
        )

    def _enough(self, limit_n: float) -> float:
        """A force near the one that was asked for needs no second look."""
        return max(limit_n, 0.9 * force_wanted_n(self._config))

    def _look(self) -> float:
        """Newest force, the smaller of what is measured; NaN before everybody was heard."""
        limits = self._limits
        assert limits is not None
        for name in ("adhesion", "load_cells"):
            for sample in self._samples(name):
                if name == "adhesion" and sample.status is Status.OK:
                    self._seen_n["the fan's speed"] = limits.speed_n(sample)
                elif name == "load_cells" and all(s is Status.OK for s in sample.status):
                    self._seen_n["the load cells"] = limits.cells_n(sample)
        wanted = limits.has_fan + (limits.zero_n is not None)
        return min(self._seen_n.values()) if len(self._seen_n) == wanted else math.nan

    def _samples(self, name: str) -> Any:
        device = self._rig.get(name)
        return () if device is None else device.read()
