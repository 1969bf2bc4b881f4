"""Drives one cell: a short climb with a fault in it, and what was seen of it."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hil.bench import Bench, open_bench
from hil.procedure.faults.cells import DURATION_S, Cell
from hil.procedure.faults.judging import CellVerdict, Seen, judge
from hil.recording.mcap_reader import read_cycles
from hil.recording.mcap_writer import McapRecorder
from hil.robot.trajectories import line
from hil.vocabulary.clock import nanoseconds
from hil.vocabulary.errors import HilError

if TYPE_CHECKING:
    from hil.vocabulary.signals import CycleRecord

_LOOK_NS = nanoseconds(0.02)
START, WAY_M = np.zeros(3), 0.12
HOLD_S, AFTERWARDS_S, CREPT_S = 0.3, 0.5, 0.3
"""Control at the end; a look at the robot after that; a look at what it does when it is said to be held."""


def run_cell(cell: Cell, bench: str = "emulated") -> CellVerdict:
    """One cell on a bench that is emulated as a whole."""
    with tempfile.TemporaryDirectory(prefix="hil-faults-") as folder:
        path = Path(folder) / "run.mcap"
        seen = _drive(cell, bench, path)
        seen.unreadable = _unreadable(path) if seen.cycles else ""
    return judge(cell, seen)


def _drive(cell: Cell, name: str, path: Path) -> Seen:
    seen = Seen()
    bench = open_bench(name, seed=cell.seed, faults=cell.specs, overrides={"emulation.plant": cell.plant})
    bench.tells_held = False
    try:
        with bench:
            bench.on_close(_follow_forces(bench, seen))
            bench.add_sink(McapRecorder(str(path), bench.header(), lossless=True))
            _climb(bench, seen)
            _watch(bench, seen)
    except HilError as error:
        seen.error = f"{type(error).__name__}: {error}"
    except Exception as error:  # what no device may raise is what the campaign looks for
        seen.foreign = f"{type(error).__name__}: {error}"
    seen.held = bench.held
    return seen


def _follow_forces(bench: Bench, seen: Seen) -> Callable[[], None]:
    """Keep the least force that truly holds the robot from now on; gives what ends that."""

    def look(t_ns: int) -> int:
        truth = bench.truth()
        if truth is not None:
            seen.adhesion_n = min(seen.adhesion_n, truth.adhesion_n)
            seen.thrust_n = min(seen.thrust_n, truth.thrust_n)
        return t_ns + _LOOK_NS

    return bench.clock.schedule(look, bench.clock.now_ns())


def _climb(bench: Bench, seen: Seen) -> None:
    """Drive up; whatever ends it, the robot has been asked to stop."""

    def look(record: CycleRecord) -> None:
        seen.cycles += 1
        seen.events += [(event.source, event.message) for event in record.events]
        truth = bench.truth()
        if truth is not None:
            seen.off_m = np.abs(truth.pose_body_in_wall - record.state.pose_body_in_wall)[:2]
            seen.sigma_m = np.sqrt(np.diag(record.state.covariance)[:2])

    way = line(START, [WAY_M, 0.0, 0.0], duration_s=DURATION_S)
    try:
        bench.drive(way, start_pose=START, hold_s=HOLD_S, on_cycle=look)
    except HilError as error:
        seen.stop = f"{type(error).__name__}: {error}"


def _watch(bench: Bench, seen: Seen) -> None:
    """Look at the robot while the bench looks after it, and then at what it truly does."""
    truth = bench.truth()
    assert truth is not None
    stopped = truth.pose_body_in_wall.copy()
    bench.look(AFTERWARDS_S)
    held = bench.look(bench.config.exit.look_after_s)
    truth = bench.truth()
    assert truth is not None
    before = truth.pose_body_in_wall.copy()
    bench.clock.sleep_until_ns(bench.clock.now_ns() + nanoseconds(CREPT_S))
    truth = bench.truth()
    assert truth is not None
    seen.said, seen.why = held.state, held.why
    seen.moved_m = float(np.hypot(*(before - stopped)[:2]))
    seen.crept_m = float(np.hypot(*(truth.pose_body_in_wall - before)[:2]))
    seen.fallen = truth.fallen


def _unreadable(path: Path) -> str:
    """Why a recording cannot be read; empty where it can."""
    try:
        problems: list[str] = []
        count = sum(1 for _ in read_cycles(path, problems))
    except HilError as error:
        return str(error)
    return "; ".join(problems) if problems or count else "it holds no cycle"
