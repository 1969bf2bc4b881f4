"""Limits of a robot on a wall whose sensors have injected faults: what sees a slide, how far it goes."""

from collections.abc import Callable
from typing import Any

import numpy as np

from hil.bench.loop_settings import adhesion_limits
from hil.config.bench import BenchConfig
from hil.core.errors import HilError, SafetyStop, UsageError
from hil.core.geometry import Array
from hil.core.interfaces import Sink
from hil.core.registry import kinds
from hil.core.signals import CycleRecord, Status, samples_of, worst
from hil.faults.permission import LONGEST_TRAVEL_M, SEES_A_SLIDE
from hil.robot.trajectories import Trajectory

_OVERSHOOT_M = 0.02
"""Distance beyond the longest travel at which the robot is stopped."""
_CELLS = "load_cells"
_TIMES = 200


def seeing_a_slide(config: BenchConfig) -> tuple[str, ...]:
    """Names of the sensors of a bench that see a slide of its robot."""
    others = config.elsewhere()
    there = [name for name in SEES_A_SLIDE if name in config.devices() and name not in others]
    return tuple(name for name in there if name != _CELLS or cells_suffice(config))


def cells_suffice(config: BenchConfig) -> bool:
    """Whether load cells that feel the fan's set-point show that the robot does not slide.

    They do not feel the propellers, whose push counts only where their controllers report it.
    """
    limits = adhesion_limits(config)
    if limits is None:
        return False
    push_n = limits.nominal_thrust_n if limits.reports_thrust else 0.0
    return limits.wanted_n >= limits.limit_n(push_n, config.environment.start_pose[2])


def must_stay_near(trajectory: Trajectory, began_at: Array | None = None) -> None:
    """Refuse a trajectory that leads farther than a robot on a wall may go with faults at links.

    Args:
        trajectory: the requested trajectory.
        began_at: (2,) place in the wall frame where the first motion began, m; None for the first place of
            the trajectory.

    Raises:
        UsageError: names the distance and the limit.
    """
    places = trajectory.sample_many(np.linspace(0.0, trajectory.duration_s, _TIMES))[0][:, :2]
    travel_m = float(np.linalg.norm(places - (places[0] if began_at is None else began_at), axis=1).max())
    if travel_m > LONGEST_TRAVEL_M:
        raise UsageError(
            f"the trajectory {trajectory.name} leads {travel_m:.2f} m away from "
            f"{'its first place' if began_at is None else 'where the first motion began'}, with faults in "
            "front of real devices on a wall",
            expected=f"at most {LONGEST_TRAVEL_M:g} m",
            remedy="drive a shorter motion, or put the robot on a tether",
        )


class TravelBound(Sink):
    """Sink that stops a robot that has gone too far, over all motions while faults may act.

    The distance is that of the sensors without a fault at the time; that of the estimate where none measures
    a position.

    Args:
        config: the bench configuration.
        struck: function from a sensor's name to True while a fault acts on it.
        over: function that returns True once all faults have ended.

    Attributes:
        began_at: (2,) estimated place in the wall frame when the wheels were first to turn, m; None before.
            At rest nothing may have told the estimator where the robot stands.
    """

    def __init__(self, config: BenchConfig, struck: Callable[[str], bool], over: Callable[[], bool]) -> None:
        seeing = seeing_a_slide(config)
        self._kinds = [kinds()[name] for name in seeing if kinds()[name].measures_position]
        self._struck, self._over = struck, over
        self._first: dict[str, Array] = {}
        self._gone_m: dict[str, float] = {}
        self._before_m: dict[str, float] = {}
        self.began_at: Array | None = None

    def write(self, record: CycleRecord) -> None:
        """Follow the places that trusted sensors measure."""
        estimated = record.state.pose_body_in_wall[:2]
        moves = np.any(record.setpoint.wheel_rate_rad_s)
        if self.began_at is None and moves and np.isfinite(estimated).all():
            self.began_at = estimated.copy()
        trusted = [kind for kind in self._kinds if not self._struck(kind.name)]
        for kind in trusted:
            for sample in samples_of(kind.name)(record.inputs):
                self._follow(kind.name, sample, kind.motion_value(sample))
        if not trusted and self.began_at is not None and np.isfinite(estimated).all():
            self._gone_m["the estimate"] = float(np.linalg.norm(estimated - self.began_at))

    def _follow(self, name: str, sample: Any, place: Array | None) -> None:
        if place is None:
            return
        if name not in self._first or worst(sample) is Status.RESET:
            self._first[name] = place
            self._before_m[name] = self._gone_m.get(name, 0.0)
        self._gone_m[name] = self._before_m[name] + float(np.linalg.norm(place - self._first[name]))

    def objection(self) -> HilError | None:
        """The stop of a robot that has gone too far; None for none."""
        far = {name: gone_m for name, gone_m in self._gone_m.items() if gone_m > _MOST_M}
        if not far or self._over():
            return None
        name, gone_m = max(far.items(), key=lambda item: item[1])
        return SafetyStop(
            "injected_travel",
            f"the robot has gone {gone_m:.2f} m by {name} since its first motion, with faults in front of "
            f"real devices on a wall: at most {LONGEST_TRAVEL_M:g} m are permitted",
        )

    def close(self) -> None:
        """Nothing to release."""


_MOST_M = LONGEST_TRAVEL_M + _OVERSHOOT_M
