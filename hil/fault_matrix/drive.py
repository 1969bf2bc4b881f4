"""Drives one cell: a short climb with a fault; collects observations for the verdict."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hil.bench import Bench, open_bench
from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import HilError
from hil.core.event_rows import event_line
from hil.core.geometry import Array
from hil.core.stop_suspects import SEPARATOR
from hil.fault_matrix.cases import DURATION_S, Cell
from hil.fault_matrix.judge import CellVerdict, judge
from hil.fault_matrix.movement_bounds import WATCHED_S
from hil.fault_matrix.observation import Figures, Seen, Told, ended_by
from hil.procedure.tracking_errors import tracking_errors
from hil.recording.mcap_reader import read_cycles
from hil.recording.mcap_writer import McapRecorder
from hil.robot.trajectories import line

if TYPE_CHECKING:
    from hil.core.signals import CycleRecord

Where = Callable[["CycleRecord"], "Array | None"]
_LOOK_NS = nanoseconds(0.02)
START, WAY_M, HOLD_S = np.zeros(3), 0.12, 0.3
"""Start pose, length of the climb and duration of the hold at its end."""
_END = 30
"""Number of cycles over which the end of a drive is averaged, as by `tracking_errors`."""
_LOOKS = 10
"""Number of position samples after the bench has closed."""


def run_cell(cell: Cell, bench: str = "emulated") -> CellVerdict:
    """Run one cell on a fully emulated bench; return its verdict."""
    return judge(cell, observed(cell, bench))


def observed(cell: Cell, name: str = "emulated", *, compared: bool = True) -> Seen:
    """Run one cell; return what was observed, also beside the same world without a fault if `compared`."""
    way: list[Array] = []
    with tempfile.TemporaryDirectory(prefix="hil-faults-") as folder:
        path = Path(folder) / "run.mcap"
        seen = _drive(cell, name, path, way)
        seen.unreadable = unreadable(path) if seen.cycles else ""
    if not compared:
        return seen
    pairs = zip(way, _way_without(name, cell.seed, cell.plant), strict=False)
    seen.effect_m = max((float(np.hypot(*(a - b))) for a, b in pairs), default=0.0)
    return seen


@lru_cache(maxsize=64)
def _way_without(name: str, seed: int, plant: str) -> tuple[Array, ...]:
    """Return the true positions (2,), m, in each cycle of the drive without a fault."""
    way: list[Array] = []
    with open_bench(name, seed=seed, overrides={"emulation.plant": plant}) as bench:
        climb(bench, Seen(), way, partial(_where, bench))
    return tuple(way)


def _drive(cell: Cell, name: str, path: Path, way: list[Array]) -> Seen:
    """Run one cell; adds the true position (2,), m, in each cycle of the drive to `way`."""
    seen = Seen()
    bench = open_bench(name, seed=cell.seed, faults=cell.specs, overrides={"emulation.plant": cell.plant})
    bench.warns_not_held, seen.on_wall = False, bench.on_wall
    stopped, end = START[:2], _follow(bench, seen)
    try:
        with bench:
            bench.add_sink(McapRecorder(str(path), bench.header(), lossless=True))
            climb(bench, seen, way, partial(_where, bench))
            stopped = _place(bench)
            seen.stopped_s = bench.clock.now_ns() / NS_PER_S
    except HilError as error:
        seen.error = ended_by(error)
    except Exception as error:  # the campaign looks for errors that no device may raise
        seen.foreign = f"{type(error).__name__}: {error}"
    seen.held, seen.looked_s = bench.held if bench.held.opened else None, bench.clock.now_ns() / NS_PER_S
    seen.moved_m = float(np.hypot(*(_place(bench) - stopped)))
    truth = bench.truth()
    if truth is not None:
        seen.held_adhesion_n = truth.adhesion_n
    _watch(bench, seen)
    seen.events = told_by(bench)
    end()
    return seen


def told_by(bench: Bench) -> list[Told]:
    """Return the events of a bench."""
    return [Told(tuple(row["device"].split(SEPARATOR)), event_line(row)) for row in bench.seen.rows()]


def _where(bench: Bench, _: CycleRecord) -> Array:
    return _place(bench)


def _place(bench: Bench) -> Array:
    """Return the true position of the robot, (2,) in m; also for a bench that did not open."""
    truth = bench.truth()
    assert truth is not None
    place: Array = truth.pose_body_in_wall[:2].copy()
    return place


def _follow(bench: Bench, seen: Seen) -> Callable[[], None]:
    """Track the least true holding forces from now on; return a function that ends this."""

    def look(t_ns: int) -> int:
        truth = bench.truth()
        if truth is not None:
            seen.adhesion_n = min(seen.adhesion_n, truth.adhesion_n)
            seen.thrust_n = min(seen.thrust_n, truth.thrust_n)
            seen.fallen = seen.fallen or truth.fallen
        return t_ns + _LOOK_NS

    return bench.clock.schedule(look, bench.clock.now_ns())


def climb(bench: Bench, seen: Seen, way: list[Array], where: Where, start: Array = START) -> None:
    """Drive up; a `HilError` that ends the drive is stored, the robot is then stopping.

    Args:
        bench: open bench.
        seen: receives what is observed.
        way: receives the position (2,) of each cycle, m from the start.
        where: function from a cycle to that position; None where it is not known.
        start: pose (3,) at which the robot stands: m, m, rad in the wall frame.
    """

    def look(record: CycleRecord) -> None:
        seen.cycles += 1
        if (here := where(record)) is None:
            return
        way.append(here)
        seen.off_m = np.abs(here - record.state.pose_body_in_wall[:2] + start[:2])
        seen.sigma_m = np.sqrt(np.diag(record.state.covariance)[:2])
        if record.reference is not None:
            apart_m = float(np.hypot(*(here - record.reference.pose_in_wall[:2] + start[:2])))
            seen.astray_m = max(seen.astray_m, apart_m)

    goal = line(start, start + np.array((WAY_M, 0.0, 0.0)), duration_s=DURATION_S)
    try:
        motion = bench.drive(goal, start_pose=start, hold_s=HOLD_S, on_cycle=look)
    except HilError as error:
        seen.stop = ended_by(error)
        return
    if not way:
        return
    errors = tracking_errors(motion)
    said_m = 1e-3 * float(np.hypot(errors["end_x"], errors["end_y"]))
    true_m = float(np.hypot(*(np.mean(way[-_END:], axis=0) - [WAY_M, 0.0])))
    seen.figures = Figures(said_m, true_m, marked=bool(errors["doubt"]))


def _watch(bench: Bench, seen: Seen) -> None:
    """Measure how far the robot truly moves after the bench has closed, and what presses it meanwhile."""
    clock, left = bench.clock, _place(bench)
    for _ in range(_LOOKS):
        clock.sleep_until_ns(clock.now_ns() + nanoseconds(WATCHED_S / _LOOKS))
        seen.crept_m = max(seen.crept_m, float(np.hypot(*(_place(bench) - left))))
        truth = bench.truth()
        if truth is not None:
            seen.left_adhesion_n = truth.adhesion_n
            seen.most_thrust_n = max(seen.most_thrust_n, truth.thrust_n)


def unreadable(path: Path) -> str:
    """Return why a recording cannot be read; empty if it can."""
    try:
        problems: list[str] = []
        count = sum(1 for _ in read_cycles(path, problems))
    except HilError as error:
        return str(error)
    return "; ".join(problems) if problems or count else "it holds no cycle"
