"""Force levels of the fan: measured at rest; load cells are fitted over the squared fan speed."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hil.bench import Bench
from hil.bench.loop_settings import adhesion_limits, force_wanted_n, thrust_wanted_n
from hil.config.bench import BenchConfig
from hil.core.errors import ConfigError, DataError
from hil.core.geometry import Array
from hil.core.signals import Status
from hil.loop.driven_motion import Motion
from hil.procedure import Context
from hil.procedure.tracking_errors import moved_at_rest, watched_to_a_seen_end
from hil.robot.statics import Statics

_STEP_N, _STEP_S, _SETTLE_S = 2.0, 0.3, 2.5
_ABOVE_LIMIT, _LEAST_N = 1.15, 8.0
_LEAST_SPREAD_N = 5.0


@dataclass(frozen=True)
class Needs:
    """Forces that a bench requires of its fan.

    Attributes:
        statics: robot and surface.
        on_wall: True if the robot can fall.
        thrust_n, wanted_n: set-points of propellers and fan, N.
        needed_n, limit_n: force that holds the robot, without and with the reserve, N.
        reserve: reserve of `[safety]`.
        rated_n, rated_rpm: rated force and speed of the fan.
    """

    statics: Statics
    on_wall: bool
    thrust_n: float
    wanted_n: float
    needed_n: float
    limit_n: float
    reserve: float
    rated_n: float
    rated_rpm: float


def needs_of(config: BenchConfig) -> Needs:
    """Return the forces for a configuration with fan and cells; raises `ConfigError` without a fan."""
    limits = adhesion_limits(config)
    if limits is None or limits.fan is None:
        raise ConfigError(f"{config.name} has no fan", remedy="add the section [adhesion] to the bench file")
    thrust_n, heading_rad = thrust_wanted_n(config), config.environment.start_pose[2]
    return Needs(
        limits.statics,
        config.environment.on_wall,
        thrust_n,
        force_wanted_n(config),
        limits.statics.needed_n(thrust_n, heading_rad),
        limits.limit_n(thrust_n, heading_rad),
        limits.reserve,
        limits.fan.rated_n,
        limits.fan.rated_rpm,
    )


@dataclass(frozen=True)
class Level:
    """Mean values of one rest; cell forces include their zeros."""

    asked_n: float
    cell_1_n: float
    cell_2_n: float
    speed_rpm: float
    input_a: float
    input_v: float
    thrust_n: float

    @property
    def cells_n(self) -> float:
        """Sum of both cells, N."""
        return self.cell_1_n + self.cell_2_n

    def to_json(self) -> dict[str, Any]:
        """Return the values as a JSON object."""
        return asdict(self)


def levels_n(config: BenchConfig, count: int, highest_n: float) -> list[float]:
    """Return the force levels, N, from the highest down; on a wall none is below the limit."""
    needs = needs_of(config)
    low_n = _ABOVE_LIMIT * needs.limit_n if needs.on_wall else _LEAST_N
    high_n = max(needs.wanted_n, highest_n)
    if high_n - low_n < _LEAST_SPREAD_N:
        raise ConfigError(
            f"force levels from {low_n:.1f} to {high_n:.1f} N are too close together",
            expected=f"{_LEAST_SPREAD_N:g} N between them",
            remedy="raise highest_n, or go to the floor",
        )
    return [float(force_n) for force_n in np.linspace(high_n, low_n, count)]


def visit(bench: Bench, force_n: float, dwell_s: float) -> Level:
    """Ramp to a force in small steps; return the mean values of a rest there."""
    fan, now_n = bench.devices.get("adhesion"), _present_n(bench)
    steps = max(1, math.ceil(abs(force_n - now_n) / _STEP_N))
    for k in range(1, steps + 1):
        fan.set_force_n(now_n + (force_n - now_n) * k / steps)
        bench.observe(_STEP_S, feedback="odometry")
    bench.observe(_SETTLE_S, feedback="odometry")
    return rest(bench, force_n, dwell_s)[0]


def rest(bench: Bench, asked_n: float, dwell_s: float) -> tuple[Level, float]:
    """Observe a robot at rest; return mean values, and how far it moved, m."""
    motion = watched_to_a_seen_end(bench, bench.observe(dwell_s, feedback="odometry"))
    return _mean(motion, asked_n, thrust_wanted_n(bench.config)), moved_at_rest(motion)


def _present_n(bench: Bench) -> float:
    motion = bench.observe(0.2, feedback="odometry")
    speeds = [s.speed_rpm for r in motion.records for s in r.inputs.adhesion if s.status is Status.OK]
    needs = needs_of(bench.config)
    return needs.rated_n * (float(np.mean(speeds)) / needs.rated_rpm) ** 2 if speeds else needs.wanted_n


def _mean(motion: Motion, asked_n: float, thrust_n: float) -> Level:
    """Return mean values of a rest; raises `DataError` with too few samples."""
    fan = [s for r in motion.records for s in r.inputs.adhesion if s.status is Status.OK]
    cells = [
        s.force_n for r in motion.records for s in r.inputs.load_cells if s.status == (Status.OK, Status.OK)
    ]
    if len(fan) < 5 or len(cells) < 5:
        raise DataError(
            "adhesion_check",
            f"has {len(fan)} reports of the fan and {len(cells)} of the cells",
            expected="5 of each at every level",
            remedy="`hil doctor` checks both; or raise dwell_s",
        )
    first, second = np.mean(cells, axis=0).tolist()
    slow = [(s.input_a, s.input_v) for s in fan if math.isfinite(s.input_a) and math.isfinite(s.input_v)]
    amps, volts = np.mean(slow, axis=0).tolist() if slow else (math.nan, math.nan)
    speed_rpm = math.sqrt(float(np.mean([s.speed_rpm**2 for s in fan])))
    return Level(asked_n, first, second, speed_rpm, amps, volts, thrust_n)


@dataclass(frozen=True)
class Fit:
    """Fit of the cells over the squared speed.

    Attributes:
        zero_n: zeros of both cells, N.
        zero_uncertainty_n: half of the 95 % interval of their sum.
        n_per_rpm2: slope of the sum of both cells.
        residual_n: RMS residual.
        levels: fitted levels.
    """

    zero_n: tuple[float, float]
    zero_uncertainty_n: float
    n_per_rpm2: float
    residual_n: float
    levels: tuple[Level, ...]

    def speed_at(self, asked_n: float) -> float:
        """Return the speed for a commanded force, from the fit of the levels."""
        forces_n = [level.asked_n for level in self.levels]
        order = np.argsort(forces_n)
        speeds = np.array([level.speed_rpm for level in self.levels])
        return float(np.interp(asked_n, np.array(forces_n)[order], speeds[order]))

    def rated_current_a(self, rated_rpm: float) -> float:
        """Return the battery current at the rated speed, scaled by speed cubed, without voltage sag."""
        per = [level.input_a * (rated_rpm / level.speed_rpm) ** 3 for level in self.levels]
        return float(np.mean(per))


def fit(levels: Sequence[Level]) -> Fit:
    """Fit straight lines to both cells over the squared speed."""
    square: Array = np.array([level.speed_rpm**2 for level in levels])
    both: Array = np.array([[level.cell_1_n, level.cell_2_n] for level in levels])
    design = np.column_stack([np.ones(len(levels)), square / square.max()])
    solution = np.linalg.lstsq(design, both, rcond=None)[0]
    rest = (both - design @ solution).sum(axis=1)
    freedom = max(len(levels) - 2, 1)
    variance = float(rest @ rest) / freedom
    spread = math.sqrt(variance * float(np.linalg.inv(design.T @ design)[0, 0]))
    return Fit(
        (float(solution[0, 0]), float(solution[0, 1])),
        2.8 * spread,
        float(solution[1].sum()) / float(square.max()),
        math.sqrt(float(rest @ rest) / len(levels)),
        tuple(levels),
    )


def draw(ctx: Context, found: Fit) -> None:
    """Draw the cells over the squared speed, with the fitted line."""
    from hil.report.plot_style import SERIES, new_figure, style

    levels, figure = found.levels, new_figure(4.6, 2.6)
    axes = style(figure.add_subplot(), "speed (1000/min) squared", "load cells (N)")
    square = np.array([0.0, max(level.speed_rpm for level in levels) ** 2])
    axes.plot(1e-6 * square, sum(found.zero_n) + found.n_per_rpm2 * square, "-", color=SERIES[1], lw=1.5)
    seen = [x.cells_n for x in levels]
    axes.plot([1e-6 * x.speed_rpm**2 for x in levels], seen, "o", color=SERIES[0], ms=5)
    ctx.figure(
        figure,
        "Force against speed",
        "Where the line meets the axis is the zero of the cells; no fan had to stop for it.",
    )
