"""Runs shipped procedures on emulated benches, and looks at the robot afterwards."""

import copy
import math
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from absent_operator import AbsentOperator

from hil.bench import open_bench
from hil.core.clock import MonotonicClock, nanoseconds
from hil.faults.files import read_faults
from hil.procedure.bench_source import BenchSource
from hil.procedure.procedure_lookup import load_procedure
from hil.procedure.run_result import Result
from hil.procedure.runner import RunOptions, run_procedure
from hil.replay.recordings import open_recording
from hil.replay.verification import verify_run

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

AS_SHIPPED = {"loop.rate_hz": 100.0}
"""For what depends on how often the bench looks."""
SAFE_HEADING_RAD = math.radians(15.0)


@dataclass(frozen=True)
class WatchedSource(BenchSource):
    """Remembers the benches that it opened, also under changed settings; may add sinks to them."""

    benches: list[Any] = field(default_factory=list)
    extra_sinks: tuple[Any, ...] = ()

    def open(self, sinks=()):
        bench = super().open((*sinks, *self.extra_sinks))
        self.benches.append(bench)
        return bench


def fragment_of(folder: Path) -> dict[str, Any]:
    """What a run leaves for the bench file."""
    return tomllib.loads((folder / "bench_fragment.toml").read_text())


@dataclass
class Run:
    """A finished run and the benches that it used."""

    result: Result
    source: WatchedSource

    @property
    def values(self) -> dict[str, float]:
        return {m["name"]: m["value"] for m in self.result.measurements}

    @property
    def failed(self) -> list[str]:
        return [m["name"] for m in self.result.measurements if m["outcome"] == "FAIL"]

    def assert_held(self):
        """See `assert_still`."""
        assert self.source.benches
        assert_still(self.source.benches)


def assert_still(benches):
    """No wheel turns and nothing moves: neither now nor two seconds later.

    A bench whose loop never ran was never enabled: there the robot is as it was found. A robot that was
    set on the wall under a heading at which it slides may do so, on locked wheels.
    """
    for bench in (b for b in benches if b.statistics.cycles):
        world = bench.world
        world.advance_to(world.now_ns + nanoseconds(0.3))
        before = copy.deepcopy(bench.truth())
        world.advance_to(world.now_ns + nanoseconds(2.0))
        after = bench.truth()
        assert np.abs(after.joint_velocity_rad_s).max() < 0.02
        assert np.abs(after.joint_position_rad - before.joint_position_rad)[:4].max() < 0.01
        assert not after.fallen or abs(bench.config.environment.start_pose[2]) > SAFE_HEADING_RAD


def watched(name: str, faults: Iterable[str] = (), **source: Any) -> WatchedSource:
    """The bench of a procedure, or another one, that keeps the benches which it has opened.

    At half the usual rate, unless its overrides say otherwise.
    """
    bench = source.pop("bench", None) or load_procedure(name).bench
    overrides = {"loop.rate_hz": 50.0, **source.pop("overrides", {})}
    return WatchedSource(bench, faults=read_faults(faults), overrides=overrides, **source)


def options_of(folder: Path, parameters: dict[str, Any] | None = None, **more: Any) -> RunOptions:
    """Of a run without anybody at the terminal."""
    given = {"operator": AbsentOperator(), **more}
    return RunOptions(folder, MonotonicClock(), "2026-01-01T00:00:00", parameters or {}, **given)


def run(name: str, folder: Path, parameters: dict[str, Any] | None = None, **source: Any) -> Run:
    """One run without anybody at the terminal."""
    used = watched(name, **source)
    return Run(run_procedure(load_procedure(name), used, options_of(folder, parameters)), used)


def true_world(bench: str, seed: int, overrides: dict[str, object] | None = None):
    """The world that a bench of this seed has: its truth is drawn when it is built."""
    return open_bench(bench, seed=seed, overrides=overrides).world


def part(world: Any, kind: type) -> Any:
    """The emulated device of a kind."""
    return next(p for p in world._parts if isinstance(p, kind))


def assert_covered(errors_over_uncertainty: list[float], *, few: bool):
    """Errors against half 95 % intervals: nearly all inside, none far outside."""
    ratio = np.abs(np.array(errors_over_uncertainty))
    assert np.isfinite(ratio).all()
    assert ratio.max() < (2.0 if few else 2.2), ratio.round(2)
    if not few:
        assert np.mean(ratio <= 1.0) >= 0.9, np.sort(ratio)[-10:].round(2)


def assert_covered_over_twenty_seeds(recover: Callable[[int, Path], Any], folder: Path):
    """As `assert_covered`, of what `recover(seed, folder)` returns first for each of twenty seeds."""
    ratios = [r for seed in range(100, 120) for r in recover(seed, folder / str(seed))[0]]
    assert_covered(ratios, few=False)


def assert_verifies(path: Path):
    """A recording of a procedure that plays scripts repeats bit for bit, every stretch of it."""
    opened = open_recording(path)
    reported = [verify_run(opened.bench, each) for each in opened.runs]
    assert [r["difference"] for r in reported] == [None] * len(reported)
    assert "script" in {each.start.controller for each in opened.runs}
    assert opened.problems == []
