"""Runs doctor, bring_up and a short climb with one wrong value; collects what was said and what was true."""

import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench import Bench, open_bench
from hil.bench.device_set_from_config import model_of
from hil.bench.doctor.degraded_bench import open_degraded
from hil.bench.doctor.examination import examine
from hil.config.bench import BenchConfig
from hil.config.loading import load_bench
from hil.core.clock import MonotonicClock, nanoseconds
from hil.core.errors import HilError
from hil.core.geometry import wrap
from hil.core.signals import CycleRecord
from hil.fault_matrix.wrong_values.cases import WrongValue, right
from hil.procedure.bench_source import BenchSource
from hil.procedure.procedure_lookup import load_procedure
from hil.procedure.runner import RunOptions, run_procedure
from hil.robot.trajectories import line

WAY_M, HOLD_S = 0.14, 0.5
"""Length of the climb, and duration of the hold at its end."""
_AFTER_S = 1.0
"""How long the robot is looked at after the bench has closed."""
_STARTED = "2000-01-01T00:00:00+00:00"
_WATCH_S, _DOCTOR_S = 2.0, 1.0
"""How long bring_up and the doctor watch the resting robot."""
_NOISES = ("noise", "walk")
"""Parts of the names of an emulated sensor's noises."""
_NO_NOISE = "moving_noise_s"


@dataclass
class Told:
    """What one stage said: texts, and whether it refused, failed or stopped."""

    texts: list[str] = field(default_factory=list)
    refused: bool = False


@dataclass
class Truth:
    """What was true at the end of the climb, and of the seconds after it.

    Attributes:
        reached_m: (2,) true place, less the goal.
        heading_rad: true heading.
        said_off_m, said_off_rad: estimate in the loop, less the truth.
        odometry_off_m: odometry less the truth.
        adhesion_n, thrust_n: true forces at rest.
        fell: True if the robot fell or slid after the stop, by more than 2 mm.
        drove: True if the climb reached its end.
    """

    reached_m: tuple[float, float] = (0.0, 0.0)
    heading_rad: float = 0.0
    said_off_m: float = 0.0
    said_off_rad: float = 0.0
    odometry_off_m: float = 0.0
    adhesion_n: float = 0.0
    thrust_n: float = 0.0
    fell: bool = False
    drove: bool = False


@dataclass
class Observed:
    """Everything that was seen of one case.

    Attributes:
        doctor, bring_up, climb: what each stage said.
        held: state in which the bench left the robot.
        parameters: `parameters` of the doctor, by key.
        contradicted: keys that any stage has found contradicted, and by what.
        truth: true state of the robot at the end.
    """

    doctor: Told = field(default_factory=Told)
    bring_up: Told = field(default_factory=Told)
    climb: Told = field(default_factory=Told)
    held: Mapping[str, Any] = field(default_factory=dict)
    parameters: dict[str, dict[str, Any]] = field(default_factory=dict)
    contradicted: dict[str, str] = field(default_factory=dict)
    truth: Truth = field(default_factory=Truth)

    def texts(self) -> Iterator[str]:
        """All that was said."""
        for stage in (self.doctor, self.bring_up, self.climb):
            yield from stage.texts

    def take(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Keep what the parameters of a stage are contradicted by."""
        self.contradicted |= {row["key"]: row["by"] for row in rows if row["state"] == "contradicted"}


def observe(case: WrongValue) -> Observed:
    """Run one case on the shipped bench; bring_up only where neither doctor nor climb names the key."""
    return _observed(case.overrides(), case.seed, case.key)


@lru_cache(maxsize=16)
def without_mistake(bench: str, plant: str, seed: int, noise: float = 1.0) -> Observed:
    """Run a bench without a wrong value.

    Args:
        bench: key of `BENCHES`.
        plant: physics model.
        seed: seed of the emulated world.
        noise: factor of the noise of all sensors.
    """
    overrides = right(bench, plant)
    if noise != 1.0:
        overrides |= noisier(load_bench("emulated", overrides=overrides), noise)
    return _observed(overrides, seed)


def noisier(config: BenchConfig, factor: float) -> dict[str, Any]:
    """Overrides with which the emulated sensors are noisier; the bench file is not told.

    Args:
        config: the bench.
        factor: factor of each noise and random walk.
    """
    found = {}
    for name in config.emulated():
        options = model_of(config, name).truth_options()
        for one in fields(options) if is_dataclass(options) else ():
            value = config.imperfections(name).get(one.name, one.default)
            noisy = any(part in one.name for part in _NOISES) and one.name != _NO_NOISE
            if noisy and isinstance(value, float):
                found[f"emulation.{name}.{one.name}"] = factor * value
    return found


def _observed(overrides: Mapping[str, Any], seed: int, key: str = "") -> Observed:
    seen = Observed()
    try:
        load_bench("emulated", overrides=overrides)
    except HilError as error:
        seen.doctor = Told([str(error), *getattr(error, "problems", ())], refused=True)
        return seen
    for stage, run in (("doctor", _examine), ("climb", _climb), ("bring_up", _bring_up)):
        told = Told()
        if stage == "bring_up" and key and any(key in text for text in seen.texts()):
            break
        setattr(seen, stage, told)
        try:
            run(seen, told, overrides, seed)
        except HilError as error:
            told.texts.append(str(error))
            told.refused = True
    return seen


def _examine(seen: Observed, told: Told, overrides: Mapping[str, Any], seed: int) -> None:
    bench, left_out = open_degraded("emulated", overrides=overrides, seed=seed)
    for finding in (*left_out, *examine(bench, watch_s=_DOCTOR_S)):
        if finding.level != "ok":
            told.texts.append(
                f"{finding.device} {finding.check}: {finding.found}; {finding.expected}; {finding.remedy}"
            )
            told.refused |= finding.level == "failure"
    seen.parameters = {row.key: row.to_json() for row in bench.parameters.rows()}
    seen.take(seen.parameters.values())


def _bring_up(seen: Observed, told: Told, overrides: Mapping[str, Any], seed: int) -> None:
    source = BenchSource("emulated", seed=seed, overrides=overrides)
    with tempfile.TemporaryDirectory(prefix="hil-wrong-values-") as folder:
        options = RunOptions(
            Path(folder) / "run", MonotonicClock(), _STARTED, {"watch_s": _WATCH_S}, keep="results"
        )
        result = run_procedure(load_procedure("bring_up"), source, options)
    seen.take(result.facts["taken_for_granted"])
    told.refused = result.verdict.value not in ("PASS", "MARGINAL")
    told.texts += [str(note) for note in result.facts.get("notes", ())]
    told.texts += [failure.message for failure in (result.error, *result.teardown_errors) if failure]
    told.texts += [f"{row['name']} failed" for row in result.measurements if row.get("verdict") == "FAIL"]
    told.texts += [row["what"] for row in result.facts.get("events", ())]


def _climb(seen: Observed, told: Told, overrides: Mapping[str, Any], seed: int) -> None:
    bench = open_bench("emulated", overrides=overrides, seed=seed)
    bench.warns_not_held = False
    try:
        with bench:
            _drive(bench, seen.truth)
    finally:
        told.texts += [row["what"] for row in bench.seen.rows()] + bench.warnings
        seen.take(row.to_json() for row in bench.parameters.rows())
        seen.held = bench.held.to_json()
        if bench.held.lost:
            told.texts.append(bench.held.why)
            told.refused = True
        _after(bench, seen.truth)


def _drive(bench: Bench, truth: Truth) -> None:
    newest: list[CycleRecord] = []
    start = bench.settle()
    goal = start + np.array([WAY_M, 0.0, 0.0])
    try:
        bench.drive(
            line(start, goal, speed_m_s=0.05), hold_s=HOLD_S, observers="odometry", on_cycle=_newest(newest)
        )
        truth.drove = True
    finally:
        now = bench.truth()
        if newest and now is not None:
            at, said = now.pose_body_in_wall, newest[0].state.pose_body_in_wall
            wanted = [WAY_M, 0.0] if truth.drove else at[:2]
            truth.reached_m = tuple(float(v) for v in at[:2] - wanted)  # type: ignore[assignment]
            truth.heading_rad = float(at[2])
            truth.said_off_m = float(np.hypot(*(said[:2] - at[:2])))
            truth.said_off_rad = wrap(float(said[2] - at[2]))
            other = newest[0].observers.get("odometry")
            if other is not None:
                truth.odometry_off_m = float(np.hypot(*(other.pose_body_in_wall[:2] - at[:2])))


def _newest(newest: list[CycleRecord]) -> Callable[[CycleRecord], None]:
    def take(record: CycleRecord) -> None:
        newest[:] = [record]

    return take


def _after(bench: Bench, truth: Truth) -> None:
    """Look at what presses and pushes the robot after the bench has closed, and whether it stays."""
    before = bench.truth()
    bench.clock.sleep_until_ns(bench.clock.now_ns() + nanoseconds(_AFTER_S))
    after = bench.truth()
    assert before is not None
    assert after is not None
    way_m = float(np.hypot(*(after.pose_body_in_wall[:2] - before.pose_body_in_wall[:2])))
    truth.fell = bool(after.fallen) or way_m > 0.002
    truth.adhesion_n, truth.thrust_n = float(after.adhesion_n), float(after.thrust_n)
