"""The four methods of the paper behind one call: Levenberg-Marquardt, interior point, GA, PSO.

All of them minimise the same `Problem`. The gradient methods use the Gauss-Newton matrix. Levenberg-Marquardt
is written here, because scipy's versions are slower and stop inside the box where bounds decide; the interior
point is scipy's. GA and PSO are pymoo's (extra `paper`). They search the directions that the data determine
(in the raw box they stop 4 to 135 % above the optimum on the authors' recordings) and are polished by
Levenberg-Marquardt; the result contains the value before and after.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.calibration.problem import Problem
from hil.core.errors import UsageError
from hil.core.geometry import Array
from hil.core.known_names import METHODS
from hil.support.extras import how_to_install, why_unusable

Progress = Callable[[int, int], None]

_LM_LIMIT, _INTERIOR_POINT_LIMIT = 200, 1000
_SIZES = {"ga": (40, 36), "pso": (30, 48)}
"""Candidates and generations of the stochastic methods."""
_RELATIVE_STEP = 1e-12
_INSIDE, _SLOPE, _STEP = 1e-3, 1e-12, 1e-12
"""Interior point: distance of the start from the box, and tolerances, in widths of the box."""
_TRUST_CONSTR_ENDED = (1, 2)
"""Status of `trust-constr` that ended by the gradient, or by the step."""
_SEARCH_STD = 3.0


@dataclass(frozen=True)
class Solution:
    """Result of a method.

    Attributes:
        z: (m,) parameters.
        objective: value at z.
        iterations: number of iterations (or generations) of the method itself.
        converged: its own criterion was met, or the minimum is within a twentieth of a standard error.
        searched: dimension of the searched subspace (stochastic methods), else len(z).
        objective_before_polish: objective of a stochastic method's best candidate, None otherwise.
    """

    z: Array
    objective: float
    iterations: int
    converged: bool
    searched: int
    objective_before_polish: float | None = None


def solve(
    problem: Problem, method: str = "lm", *, seed: int = 0, progress: Progress | None = None
) -> Solution:
    """Minimise a problem; the gradient methods start from its nominal parameters.

    Args:
        problem: problem to minimise.
        method: `lm`, `interior-point`, `ga` or `pso`.
        seed: seed of the stochastic methods.
        progress: called with (done, total) generations by the stochastic methods.

    Raises:
        UsageError: another method.
    """
    if method == "lm":
        return levenberg_marquardt(problem, problem.nominal)
    if method == "interior-point":
        return interior_point(problem, problem.nominal)
    if method in _SIZES:
        return _stochastic(problem, method, seed, progress)
    raise UsageError(f"method {method!r}", expected="one of " + ", ".join(METHODS))


def levenberg_marquardt(problem: Problem, z0: Array, limit: int = _LM_LIMIT) -> Solution:
    """Levenberg-Marquardt with damped steps solved within the box (More 1978; Kanzow et al. 2004).

    Args:
        problem: problem to solve.
        z0: (m,) start.
        limit: largest number of iterations.
    """
    z, damping = problem.clip(z0), 1e-3
    value, gradient, hessian = problem.gradient_terms(z)
    iterations, converged, moved = 0, False, False
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
            converged = relative < 1e-9
        else:
            damping *= 6.0
            converged = damping > 1e12
    return Solution(z, value, iterations, converged, len(z))


def standard_errors_left(problem: Problem, z: Array) -> float:
    """Length of an undamped Gauss-Newton step from z (m,), in standard errors of its direction."""
    _, gradient, hessian = problem.gradient_terms(z)
    return float(np.sqrt(gradient @ np.linalg.solve(hessian, gradient)))


def _box_step(
    problem: Problem, z: Array, gradient: Array, hessian: Array, damping: float
) -> tuple[Array, float]:
    """Best damped Gauss-Newton step within the box: its end point, and the predicted decrease of the cost.

    The step s minimises 2 g's + s'(H + damping diag H)s, which is |A s - b|^2 with A'A = H + ... and A'b =
    -g; with parameters scaled by the root of diag H the matrix is well conditioned. A step clipped to the box
    parameter by parameter would stop at corners where the cost still falls along a side. Most steps end
    within the box; then scipy's solver, which takes half a second to import, is not called.
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
    """Method `trust-constr` of scipy: a barrier for the box, a trust region, and the Gauss-Newton matrix.

    Args:
        problem: problem to solve.
        z0: (m,) start.
    """
    from scipy.optimize import Bounds, minimize

    width = problem.upper - problem.lower

    def place(u: Array) -> Array:
        return np.asarray(problem.lower + width * u, dtype=np.float64)

    def terms(u: Array) -> tuple[float, Array, Array]:
        value, gradient, hessian = problem.gradient_terms(place(u))
        return value, 2.0 * width * gradient, 2.0 * width[:, None] * hessian * width

    start = np.clip((problem.clip(z0) - problem.lower) / width, _INSIDE, 1.0 - _INSIDE)
    found: Any = minimize(  # type: ignore[call-overload]
        lambda u: problem.objective(place(u)),
        start,
        method="trust-constr",
        jac=lambda u: terms(u)[1],
        hess=lambda u: terms(u)[2],
        bounds=Bounds(0.0, 1.0),
        options={
            "maxiter": _INTERIOR_POINT_LIMIT,
            "gtol": _SLOPE * max(problem.objective(place(start)), 1e-12),
            "xtol": _STEP,
            "barrier_tol": _SLOPE,
        },
    )
    z = problem.clip(place(found.x))
    converged = int(found.status) in _TRUST_CONSTR_ENDED
    return Solution(z, problem.objective(z), int(found.nit), converged, len(z))


def _stochastic(problem: Problem, method: str, seed: int, progress: Progress | None) -> Solution:
    """Search in whitened coordinates of the determined directions, then polish with Levenberg-Marquardt."""
    directions = determined_directions(problem)

    def candidate(s: Array) -> Array:
        return problem.clip(problem.nominal + directions @ s)

    best, generations = _searched(
        method, lambda s: problem.objective(candidate(s)), directions.shape[1], seed, progress
    )
    z = candidate(best)
    found = problem.objective(z)
    polished = levenberg_marquardt(problem, z)
    return Solution(
        polished.z, polished.objective, generations, polished.converged, directions.shape[1], found
    )


def determined_directions(problem: Problem) -> Array:
    """Columns (m, d): directions that the data determine better than the prior, one prior std long.

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


def _searched(
    method: str, objective: Callable[[Array], float], dimension: int, seed: int, progress: Progress | None
) -> tuple[Array, int]:
    """Best point (d,) of pymoo's GA or PSO, in prior standard deviations, and the number of generations."""
    if why := why_unusable("paper"):
        raise UsageError(f"method {method!r} needs the extra paper: {why}", remedy=how_to_install("paper"))
    from pymoo.algorithms.soo.nonconvex.ga import GA
    from pymoo.algorithms.soo.nonconvex.pso import PSO
    from pymoo.core.callback import Callback
    from pymoo.optimize import minimize
    from pymoo.problems.functional import FunctionalProblem

    people, generations = _SIZES[method]
    drawn = np.random.default_rng(seed)
    first = drawn.uniform(-_SEARCH_STD, _SEARCH_STD, (people, dimension))
    first[0] = 0.0

    class Progress(Callback):  # type: ignore[misc]
        """Reports each generation to `progress`."""

        def notify(self, algorithm: Any) -> None:
            if progress is not None:
                progress(algorithm.n_gen, generations)

    algorithm = {"ga": GA, "pso": PSO}[method](pop_size=people, sampling=first)
    box = np.full(dimension, 2.0 * _SEARCH_STD)
    found = minimize(
        FunctionalProblem(dimension, objective, xl=-box, xu=box),
        algorithm,
        ("n_gen", generations),
        seed=seed,
        callback=Progress(),
        verbose=False,
    )
    return np.asarray(found.X, dtype=np.float64), generations
