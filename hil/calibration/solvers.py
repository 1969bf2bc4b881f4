"""The four methods of the paper behind one call: Levenberg-Marquardt, interior point, GA, PSO.

All of them minimise the same `Problem`. The gradient methods use the Gauss-Newton matrix; the
stochastic ones search the directions that the data determine (in the raw box they stop 4 to 135 %
above the optimum on the authors' recordings) and are polished by a gradient method (interior
point where there is a box); the result says both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from hil.calibration.problem import Problem
from hil.vocabulary.choices import METHODS
from hil.vocabulary.errors import UsageError
from hil.vocabulary.geometry import Array

Progress = Callable[[int, int], None]

_LM_LIMIT, _INTERIOR_POINT_LIMIT = 200, 80
_POPULATION, _GENERATIONS = 40, 36
_PARTICLES, _MOVES = 30, 48
_RELATIVE_STEP = 1e-12
_SEARCH_STD = 3.0


@dataclass(frozen=True)
class Solution:
    """Where a method ended.

    Attributes:
        z: (m,) parameters.
        objective: value at z.
        iterations: of the method itself.
        converged: its own criterion was met, or less than a twentieth of a standard error is left to go.
        searched: dimension of the searched subspace (stochastic methods), else len(z).
        objective_before_polish: of a stochastic method's best candidate, None otherwise.
    """

    z: Array
    objective: float
    iterations: int
    converged: bool
    searched: int
    objective_before_polish: float | None = None
    history: tuple[float, ...] = field(default=(), repr=False)


def solve(
    problem: Problem,
    method: str = "lm",
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> Solution:
    """Minimise a problem; the gradient methods start from its nominal parameters.

    Args:
        problem: what to minimise.
        method: `lm`, `interior-point`, `ga` or `pso`.
        seed: of the stochastic methods.
        progress: called with (done, total) generations by the stochastic methods.

    Raises:
        UsageError: another method.
    """
    if method == "lm":
        return levenberg_marquardt(problem, problem.nominal)
    if method == "interior-point":
        return interior_point(problem, problem.nominal)
    if method in ("ga", "pso"):
        search = genetic if method == "ga" else particle_swarm
        return _stochastic(problem, search, np.random.default_rng(seed), progress)
    raise UsageError(f"method {method!r}", expected="one of " + ", ".join(METHODS))


def levenberg_marquardt(problem: Problem, z0: Array, limit: int = _LM_LIMIT) -> Solution:
    """Levenberg-Marquardt whose damped steps are solved within the box (More 1978; Kanzow et al. 2004).

    Args:
        problem: to solve.
        z0: (m,) start.
        limit: of iterations.
    """
    z, damping = problem.clip(z0), 1e-3
    value, gradient, hessian = problem.gradient_terms(z)
    history, iterations, converged, moved = [value], 0, False, False
    while iterations < limit and not converged:
        iterations += 1
        if moved:
            _, gradient, hessian = problem.gradient_terms(z)
            moved = False
        trial, expected = _box_step(problem, z, gradient, hessian, damping)
        if expected <= _RELATIVE_STEP * max(value, 1e-12):
            converged = True
            break
        trial_value = problem.objective(trial)
        if trial_value < value:
            gain = (value - trial_value) / max(expected, 1e-300)
            damping = max(damping * (0.2 if gain > 0.5 else 1.0), 1e-12)
            relative = (value - trial_value) / max(value, 1e-300)
            z, value, moved = trial, trial_value, True
            history.append(value)
            converged = relative < 1e-9
        else:
            damping *= 6.0
            converged = damping > 1e12
    return Solution(z, value, iterations, converged, len(z), history=tuple(history))


def standard_errors_left(problem: Problem, z: Array) -> float:
    """How far an undamped Gauss-Newton step would go from z (m,), in standard errors of its direction."""
    _, gradient, hessian = problem.gradient_terms(z)
    return float(np.sqrt(gradient @ np.linalg.solve(hessian, gradient)))


def _box_step(
    problem: Problem, z: Array, gradient: Array, hessian: Array, damping: float
) -> tuple[Array, float]:
    """Best damped Gauss-Newton step within the box: where it ends, and by how much the cost should fall.

    The step s minimises 2 g's + s'(H + damping diag H)s, which is |A s - b|^2 with A'A = H + ... and
    A'b = -g; with parameters scaled by the root of diag H the matrix is well conditioned. A step cut off at
    the box parameter by parameter would stop at corners where the cost still falls along a side. Most steps
    end within the box, and scipy's solver, half a second to import, is not asked.
    """
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-12))
    values, vectors = np.linalg.eigh(hessian / np.outer(scale, scale) + damping * np.eye(len(z)))
    root = np.sqrt(np.maximum(values, 1e-14))
    wanted = -(vectors.T @ (gradient / scale)) / root
    trial = z + vectors @ (wanted / root) / scale
    if np.any(trial < problem.lower) or np.any(trial > problem.upper):
        from scipy.optimize import lsq_linear

        box = scale * (problem.lower - z), scale * (problem.upper - z)
        found = lsq_linear(root[:, None] * vectors.T, wanted, box, method="bvls", max_iter=10 * len(z))
        trial = problem.clip(z + found.x / scale)
    moved = trial - z
    return trial, float(-(2 * gradient @ moved + moved @ hessian @ moved))


def interior_point(problem: Problem, z0: Array) -> Solution:
    """Primal-dual interior point with the Gauss-Newton matrix (Nocedal and Wright, chapter 19).

    Args:
        problem: to solve.
        z0: (m,) start.
    """
    lower, upper = problem.lower, problem.upper
    span = upper - lower
    z = np.clip(z0, lower + 1e-3 * span, upper - 1e-3 * span)
    value, gradient, hessian = problem.gradient_terms(z)
    barrier = 0.1 * max(value, 1e-9) / len(z)
    dual_low, dual_up = barrier / (z - lower), barrier / (upper - z)
    history, iterations, damping = [value], 0, 1e-9
    while iterations < _INTERIOR_POINT_LIMIT:
        iterations += 1
        low, up = z - lower, upper - z
        matrix = 2 * hessian + np.diag(dual_low / low + dual_up / up)
        matrix += damping * np.diag(np.diag(hessian))
        rhs = -(2 * gradient - barrier / low + barrier / up)
        step = np.linalg.solve(matrix, rhs)
        step_low = barrier / low - dual_low - dual_low / low * step
        step_up = barrier / up - dual_up + dual_up / up * step
        primal = _largest_step(np.r_[low, up], np.r_[step, -step])
        dual = _largest_step(np.r_[dual_low, dual_up], np.r_[step_low, step_up])
        merit = _merit(value, low, up, barrier)
        for _ in range(12):
            trial = z + primal * step
            trial_value = problem.objective(trial)
            if _merit(trial_value, trial - lower, upper - trial, barrier) <= merit + 1e-12 * abs(merit):
                break
            primal *= 0.4
        else:
            damping = max(damping * 100.0, 1e-6)
            if damping > 1e6:
                break
            continue
        damping = max(damping * 0.1, 1e-9)
        z = trial
        dual_low, dual_up = dual_low + dual * step_low, dual_up + dual * step_up
        value, gradient, hessian = problem.gradient_terms(z)
        history.append(value)
        gap = float(dual_low @ (z - lower) + dual_up @ (upper - z))
        if gap <= 1e-7 * max(value, 1e-12) and float(np.max(np.abs(step) / span)) < 1e-4:
            break
        barrier = min(barrier, 0.1 * gap / (2 * len(z)))
    converged = iterations < _INTERIOR_POINT_LIMIT
    return Solution(z, value, iterations, converged, len(z), history=tuple(history))


def _largest_step(values: Array, steps: Array) -> float:
    """Fraction to the boundary, at most 1."""
    shrinking = steps < 0
    if not shrinking.any():
        return 1.0
    return float(min(1.0, 0.995 * np.min(-values[shrinking] / steps[shrinking])))


def _merit(value: float, low: Array, up: Array, barrier: float) -> float:
    if np.any(low <= 0) or np.any(up <= 0):
        return np.inf
    return value - barrier * float(np.log(low).sum() + np.log(up).sum())


Search = Callable[[Callable[[Array], float], int, np.random.Generator, Progress | None], tuple[Array, int]]


def _stochastic(
    problem: Problem, search: Search, rng: np.random.Generator, progress: Progress | None
) -> Solution:
    """Search in whitened coordinates of the determined directions, then polish."""
    directions = determined_directions(problem)

    def candidate(s: Array) -> Array:
        return problem.clip(problem.nominal + directions @ s)

    best, generations = search(lambda s: problem.objective(candidate(s)), directions.shape[1], rng, progress)
    z = candidate(best)
    found = problem.objective(z)
    boxed = problem.setting.bounds is not None
    polished = interior_point(problem, z) if boxed else levenberg_marquardt(problem, z)
    return Solution(
        polished.z, polished.objective, generations, polished.converged, directions.shape[1], found
    )


def determined_directions(problem: Problem) -> Array:
    """(m, d) columns: directions that the data determine better than the prior, one prior std long.

    Data information J'J is whitened by the prior spread; directions with more than the prior's own
    information are kept.
    """
    _, _, hessian = problem.gradient_terms(problem.nominal)
    information = hessian - np.diag(problem.prior_precision())
    if problem.setting.bounds is not None:
        information = information / (0.006**2)
    spread = problem.prior_std
    values, vectors = np.linalg.eigh(spread[:, None] * information * spread[None, :])
    keep = values > 1.0
    return np.asarray((spread[:, None] * vectors)[:, keep][:, ::-1], dtype=np.float64)


def genetic(
    objective: Callable[[Array], float], dimension: int, rng: np.random.Generator,
    progress: Progress | None = None,
) -> tuple[Array, int]:  # fmt: skip
    """Real-coded genetic algorithm: tournament, blend crossover, shrinking Gaussian mutation, elite.

    Args:
        objective: value of a point (d,), in prior standard deviations.
        dimension: d.
        rng: source of all randomness.
        progress: told after each generation.

    Returns:
        The best point (d,) and the count of generations.
    """
    people = rng.uniform(-_SEARCH_STD, _SEARCH_STD, (_POPULATION, dimension))
    people[0] = 0.0
    cost = np.array([objective(p) for p in people])
    for generation in range(_GENERATIONS):
        rivals = rng.integers(_POPULATION, size=(2, 2, _POPULATION))
        winners = np.where(cost[rivals[0]] < cost[rivals[1]], rivals[0], rivals[1])
        mix = rng.uniform(-0.25, 1.25, (_POPULATION, dimension))
        children = mix * people[winners[0]] + (1 - mix) * people[winners[1]]
        spread = 0.5 * 0.88**generation
        mutate = rng.random((_POPULATION, dimension)) < 0.3
        children += mutate * rng.normal(0.0, spread, (_POPULATION, dimension))
        elite = people[np.argsort(cost, kind="stable")[:2]]
        elite_cost = np.sort(cost)[:2]
        child_cost = np.array([objective(c) for c in children])
        worst = np.argsort(child_cost, kind="stable")[-2:]
        children[worst], child_cost[worst] = elite, elite_cost
        people, cost = children, child_cost
        if progress is not None:
            progress(generation + 1, _GENERATIONS)
    return people[int(np.argmin(cost))], _GENERATIONS


def particle_swarm(
    objective: Callable[[Array], float], dimension: int, rng: np.random.Generator,
    progress: Progress | None = None,
) -> tuple[Array, int]:  # fmt: skip
    """Particle swarm with constriction (Clerc and Kennedy 2002): inertia 0.7298, pulls 1.49618.

    Args:
        objective: value of a point (d,), in prior standard deviations.
        dimension: d.
        rng: source of all randomness.
        progress: told after each generation.

    Returns:
        The best point (d,) and the count of generations.
    """
    place = rng.uniform(-_SEARCH_STD, _SEARCH_STD, (_PARTICLES, dimension))
    place[0] = 0.0
    speed = rng.uniform(-1.0, 1.0, (_PARTICLES, dimension))
    best, cost = place.copy(), np.array([objective(p) for p in place])
    for generation in range(_MOVES):
        leader = best[int(np.argmin(cost))]
        own, social = rng.random((2, _PARTICLES, dimension))
        speed = 0.7298 * speed + 1.49618 * (own * (best - place) + social * (leader - place))
        place = place + speed
        now = np.array([objective(p) for p in place])
        better = now < cost
        best[better], cost[better] = place[better], now[better]
        if progress is not None:
            progress(generation + 1, _MOVES)
    return best[int(np.argmin(cost))], _MOVES
