"""Fits a parameter vector to recordings: robust weights, continuation, then the chosen method.

The dry-friction model has bad minima. So it is fitted through a chain of easier problems: friction exponent 2
(least squares), 1.5, 1.2, 1 (Coulomb), each started at the solution before. The weights per recording come
from a Levenberg-Marquardt pre-fit that all methods share. Stochastic methods search the least-squares
problem; Levenberg-Marquardt then follows the chain from their result.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.calibration.motion_models import linear_matrix, make_model
from hil.calibration.problem import Problem, Setting
from hil.calibration.solvers import (
    Progress,
    Solution,
    interior_point,
    levenberg_marquardt,
    solve,
    standard_errors_left,
)
from hil.core.geometry import Array
from hil.datasets.fit_blocks import Blocks
from hil.robot.kinematics import WheelGeometry

_CHAIN = (2.0, 1.5, 1.2, 1.0)
_REWEIGHTINGS = 4
_STEPS_IN_A_BOX = 100
_CLEARLY_BETTER, _BETTER, _OUTLYING = 0.7, 0.9, 9.0
_NEAR = 0.05


@dataclass(frozen=True)
class Fit:
    """A fitted problem: `solution.z` are the parameters, `problem.weights` one weight per recording."""

    problem: Problem
    solution: Solution

    @property
    def geometry(self) -> WheelGeometry:
        """The fitted wheel geometry."""
        return self.problem.tyres.with_vector(self.solution.z)


def chain(setting: Setting) -> Sequence[float]:
    """Sequence of friction exponents to fit through; one stage for the linear models."""
    return _CHAIN if setting.model == "dry-friction" else (2.0,)


def fit(
    blocks: Blocks,
    setting: Setting,
    nominal: WheelGeometry,
    *,
    method: str = "lm",
    seed: int = 0,
    start: Array | None = None,
    progress: Progress | None = None,
) -> Fit:
    """Fit the parameters to blocks of recordings.

    Args:
        blocks: reduced recordings.
        setting: parameters to fit, and their weights.
        nominal: start, prior mean and centre of the box.
        method: `lm`, `interior-point`, `ga` or `pso`.
        seed: seed of the stochastic methods.
        start: parameters (m,), for the short fit of a cross-validation's fold. Only the paper's cost, which
            is then iterated to its end, starts there; a robust fit goes through the chain from nominal,
            because a few steps from a solution fitted to the left-out runs, too, would stay near it.
        progress: called with the generations of the stochastic methods.
    """
    problem = Problem(blocks, setting, nominal)
    if start is not None:
        return _fold(problem, start)
    prefit = _robust_prefit(problem) if setting.robust or method == "lm" else None
    if prefit is not None and prefit.problem.setting != setting:
        setting, problem = prefit.problem.setting, prefit.problem
    if method == "lm" and prefit is not None:
        return _settled(prefit)
    weights = prefit.problem.weights if prefit is not None else problem.weights
    z: Array | None = None
    first: Solution | None = None
    for power in chain(setting):
        stage = problem.with_power(power).with_weights(weights)
        if z is None and method in ("ga", "pso"):
            solution = first = solve(_linear(stage), method, seed=seed, progress=progress)
            if len(chain(setting)) == 1:
                return Fit(stage, solution)
        elif method == "interior-point":
            solution = interior_point(stage, stage.nominal if z is None else z)
        else:
            assert z is not None
            solution = levenberg_marquardt(stage, z, limit=40)
        z = solution.z
    if first is not None:
        solution = replace(
            solution,
            searched=first.searched,
            objective_before_polish=first.objective_before_polish,
            iterations=first.iterations,
        )
    return _settled(Fit(stage, solution))


def _settled(found: Fit) -> Fit:
    """The fit, iterated further where it is not yet near its minimum.

    Applies only where the objective has a scale (`sigma`) and no box, so that standard errors are defined.
    """
    problem, solution = found.problem, found.solution
    if solution.converged or problem.setting.sigma is None or problem.setting.bounds is not None:
        return found
    if standard_errors_left(problem, solution.z) < _NEAR:
        return Fit(problem, replace(solution, converged=True))
    further = levenberg_marquardt(problem, solution.z)
    return Fit(
        problem,
        replace(
            solution,
            z=further.z,
            objective=further.objective,
            converged=further.converged,
            iterations=solution.iterations + further.iterations,
        ),
    )


def _linear(stage: Problem) -> Problem:
    """The exact (linear) model in place of dry friction at exponent 2.

    Both are the same but for unequal loads, which weight the wheels in dry friction. As a start for the next
    exponent the model without loads is close enough.
    """
    if stage.setting.model != "dry-friction":
        return stage
    twin = Problem(
        stage.blocks, replace(stage.setting, model="exact"), stage.tyres.with_vector(stage.nominal)
    )
    return twin.counting_with(stage).with_weights(stage.weights)


def _robust_prefit(problem: Problem, rounds_at_ends: int = _REWEIGHTINGS, last_limit: int = 10) -> Fit:
    """Chain of Levenberg-Marquardt fits with Cauchy weights updated along the way.

    Where a box replaces the prior, directions that the data do not determine are flat. The last fit then runs
    to its end, so that the box decides them and not the number of steps.
    """
    last_limit = last_limit if problem.setting.bounds is None else _STEPS_IN_A_BOX
    z, weights = problem.nominal, problem.weights
    robust = problem.setting.robust
    powers = chain(problem.setting)
    for power in powers:
        stage = problem.with_power(power) if power != 2.0 else _linear(problem)
        last = power == powers[-1]
        rounds = (rounds_at_ends if last or power == 2.0 else 1) if robust else 1
        for _ in range(rounds):
            limit = 4 if robust else 200
            solution = levenberg_marquardt(stage.with_weights(weights), z, limit=limit)
            z = solution.z
            if robust:
                weights = stage.cauchy_weights(z)
        solution = levenberg_marquardt(stage.with_weights(weights), z, limit=last_limit) if last else solution
        z = solution.z
        if power == 2.0:
            least_squares = Fit(stage.with_weights(weights), solution)
    final = Fit(problem.with_power(powers[-1]).with_weights(weights), solution)
    if problem.setting.choose_model and not _explains_better(final, least_squares):
        return least_squares
    return final


def _explains_better(one: Fit, other: Fit) -> bool:
    """Whether a fit explains the typical recording clearly better than another one, and all together.

    Unweighted costs are compared: both models have the same parameters and prior. Robust weights could settle
    on one half of the recordings, which dry friction fits well at the cost of the other half.
    """
    costs, others = (f.problem.recording_costs(f.solution.z) for f in (one, other))
    typical = float(np.median(others))
    together = [float(np.minimum(c, _OUTLYING * typical).mean()) for c in (costs, others)]
    return float(np.median(costs)) <= _CLEARLY_BETTER * typical and together[0] <= _BETTER * together[1]


def _fold(problem: Problem, start: Array) -> Fit:
    """Fit of a cross-validation fold: fewer iterations, the same model as the fit on all recordings."""
    if not problem.setting.robust:
        return Fit(problem, levenberg_marquardt(problem, problem.clip(start), limit=60))
    fixed = Problem(
        problem.blocks,
        replace(problem.setting, choose_model=False),
        problem.tyres.with_vector(problem.nominal),
    )
    return _robust_prefit(fixed.counting_with(problem), rounds_at_ends=2, last_limit=5)


def twist_between(found: Fit, nominal: WheelGeometry) -> Array:
    """Correction C (3, 3) that applies a fit of any model through nominal odometry.

    Least squares of the fitted model's body motion on the nominal model's, over the recordings.
    """
    wheel_rad = found.problem.blocks.wheel_rad.reshape(-1, 8)
    fitted = make_model(found.problem.setting.model, wheel_rad, nominal).motion(found.solution.z)
    plain = make_model("exact", wheel_rad, nominal).motion(nominal.vector())
    return np.asarray(np.linalg.lstsq(plain, fitted, rcond=None)[0].T, dtype=np.float64)


def twist_correction(z: Array, nominal: WheelGeometry) -> Array:
    """C (3, 3): actual body twist = C times the twist of nominal odometry.

    C is all that rigid-body commands can reveal about the parameters. Applied with nominal inverse kinematics
    it avoids the directions that the data do not determine.
    """
    per_wheel = nominal.projection() / np.repeat(nominal.radius_m, 2)[:, None]
    return np.asarray(linear_matrix(z, "exact") @ per_wheel, dtype=np.float64)
