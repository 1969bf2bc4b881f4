"""Drives round trips for the camera's calibration; keeps the camera and motion capture samples of each leg.

All legs are driven on one bench; in virtual time with several processes, each round trip has its own bench.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from hil.bench import Bench
from hil.core.clock import NS_PER_S
from hil.core.geometry import Array
from hil.loop.driven_motion import Motion
from hil.procedure import Context
from hil.procedure.parallel_benches import DriveJob
from hil.procedure.sample_arrays import Series, camera, poses
from hil.procedure.tracking_errors import STAGGER_S, enable_hold
from hil.procedure.worker_processes import Workers
from hil.robot.trajectories import Trajectory, line

Trip = tuple[tuple[float, float, float], ...]
"""Poses of a round trip, relative to its start, m and rad; the last one is the start."""
_REST_S = 0.5
_BETWEEN_S = 1.0


@dataclass(frozen=True)
class Leg:
    """Samples of one leg; times in s since the first cycle of its bench's first leg.

    Attributes:
        begin_s, end_s: begin and end of the leg.
        truth: poses by motion capture, (n, 3).
        seen: the camera's own poses, as returned by `hil.procedure.sample_arrays.camera`.
        aligned: poses of the body by the camera and its configured mount, (n, 3).
    """

    begin_s: float
    end_s: float
    truth: Series
    seen: Series
    aligned: Series

    def later(self, by_s: float) -> Leg:
        """Return the same leg, shifted by `by_s`."""
        return Leg(
            self.begin_s + by_s,
            self.end_s + by_s,
            self.truth.later(by_s),
            self.seen.later(by_s),
            self.aligned.later(by_s),
        )


def legs_of(trips: Sequence[Trip], start: Array, speed_m_s: float) -> list[Trajectory]:
    """Return the legs of round trips from one pose, in order."""
    legs, before = [], np.zeros(3)
    for stop in (stop for trip in trips for stop in trip):
        after = np.array(stop, dtype=np.float64)
        name = "to {:.2g} {:.2g} {:.2g}".format(*stop)
        legs.append(line(start + before, start + after, speed_m_s=speed_m_s, name=name))
        before = after
    return legs


def drive_trips(
    ctx: Context, slug: str, trips: Sequence[Trip], overrides: Mapping[str, object]
) -> list[list[Leg]]:
    """Drive round trips; return the legs of each, on one time axis.

    Args:
        ctx: context of the run; its parameters hold `speed_m_s` and `processes`.
        slug: label of the bench's recording for `Context.reopen`.
        trips: round trips.
        overrides: overrides of the bench.
    """
    p: Any = ctx.parameters
    total = sum(map(len, trips))
    done: list[list[Leg]] = []
    if p.processes > 1 and ctx.source.virtual:
        source = ctx.source.changed(overrides=overrides)
        drive_jobs = [
            DriveJob(source, partial(_alone, trip=trip, speed_m_s=p.speed_m_s, number=number))
            for number, trip in enumerate(trips)
        ]
        with Workers(min(p.processes, len(trips))) as workers:
            for legs in ctx.at_once(drive_jobs, workers):
                shift_s = done[-1][-1].end_s + _BETWEEN_S if done else 0.0
                done.append([leg.later(shift_s) for leg in legs])
                ctx.progress(ctx.where, sum(map(len, done)), total)
        return done
    bench = ctx.reopen(slug, overrides=overrides)
    coming = iter(_legs(bench, trips, p.speed_m_s, _REST_S, lambda k: ctx.progress(ctx.where, k, total)))
    return [[next(coming) for _ in trip] for trip in trips]


def _legs(
    bench: Bench, trips: Sequence[Trip], speed_m_s: float, rest_s: float, on_trip: Callable[[int], object]
) -> Iterator[Leg]:
    """Drive on one bench; odometry continues from one leg to the next."""
    here = begin = enable_hold(bench, rest_s)
    first_ns: int | None = None
    for number, leg in enumerate(legs_of(trips, begin, speed_m_s), start=1):
        motion = bench.drive(leg, feedback="odometry", hold_s=0.2, start_pose=here)
        here = motion.estimate[-1]
        began_ns = motion.records[0].inputs.t_ns
        first_ns = began_ns if first_ns is None else first_ns
        on_trip(number)
        yield _seen(motion).later((began_ns - first_ns) / NS_PER_S)


def _seen(motion: Motion) -> Leg:
    """Return the samples of a leg that begins at 0, without older samples from queues."""
    truth, aligned = (poses(motion, kind).since(0.0) for kind in ("mocap", "tracker"))
    return Leg(0.0, float(motion.t_s[-1]), truth, camera(motion).since(0.0), aligned)


def _alone(bench: Bench, trip: Trip, speed_m_s: float, number: int) -> list[Leg]:
    """Drive a trip in another process, a little later than others, so that it does not repeat their noise."""
    return list(_legs(bench, [trip], speed_m_s, _REST_S + STAGGER_S * number, lambda k: None))
