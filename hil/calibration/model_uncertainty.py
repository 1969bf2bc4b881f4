"""The uncertainty that the choice of model adds: other contact laws, wheel loads and tyres.

A fit believes one law, one share of the weight on each wheel and one kind of tyre. Were another one true, its
parameters would be off although its residuals look fine. How far is linear in how much another model reads
the same wheels differently, and how much of another model there is, the residuals tell, within limits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hil.calibration.evaluation import rolled
from hil.calibration.fitting import Fit
from hil.calibration.problem import Problem
from hil.core.geometry import Array
from hil.robot.contact_laws import creep_motion, least_dissipation
from hil.robot.kinematics import WheelGeometry, projection

_LOAD_SIGMA = 0.15
_LOAD_PATTERNS = np.array([[1.0, -1.0, -1.0, 1.0], [1.0, 1.0, -1.0, -1.0], [1.0, -1.0, 1.0, -1.0]])
_TYRE_RATIOS = (0.4, 1.0)
_EFFECTIVE = 3.0
_LEAST_NOISE = 0.05


def model_freedom(fit: Fit, inverse: Array) -> Array:
    """Covariance (m, m) that the choice of the forward model leaves in the parameters.

    Each other model is mixed in by a share, with a standard deviation of one before the data. The shares are
    estimated from what the fit left over; their mean square goes into the parameters as the fit would have
    taken it up.

    Args:
        fit: judged.
        inverse: (m, m) inverse of its total information.
    """
    problem, z = fit.problem, fit.solution.z
    believed = problem.errors(z)
    others = [problem.errors_of(motion) - believed for motion in _other_motions(problem, z)]
    gram = problem.gram(z, np.stack(others, axis=-1))
    size = len(z)
    cross, theirs = gram[:size, size:-1], gram[size:-1, size:-1]
    left = gram[size:-1, -1] - cross.T @ inverse @ (gram[:size, -1] + _pull(problem, z))
    noise = max(gram[-1, -1] / (_EFFECTIVE * max(problem.weights.sum(), 1.0)), _LEAST_NOISE)
    reported = (theirs - cross.T @ inverse @ cross) / noise
    covariance = np.linalg.inv(reported + np.eye(len(reported)))
    share = -covariance @ left / noise
    shift = inverse @ cross
    return np.asarray(shift @ (covariance + np.outer(share, share)) @ shift.T, dtype=np.float64)


def _pull(problem: Problem, z: Array) -> Array:
    """Half the gradient of the prior (m,)."""
    return np.asarray(problem.prior_precision() * (z - problem.nominal), dtype=np.float64)


def _other_motions(problem: Problem, z: Array) -> Iterator[Array]:
    """Body motion (n, 3) of the same wheels as every other model reads them."""
    law, tyres = problem.setting.model, problem.tyres
    wheel_rad = problem.blocks.wheel_rad.reshape(-1, 8)
    p, u = projection(z[0:4], z[4:8]), rolled(z, wheel_rad)
    for other in ("exact", "dry-friction"):
        if other != law or (law == "dry-friction" and np.ptp(tyres.load) > 0.0):
            yield _moved(other, p, u, tyres)
    for ratio in _TYRE_RATIOS:
        yield _moved("creep", p, u, replace(tyres, creep_ratio=ratio))
    for pattern in _LOAD_PATTERNS:
        load = tyres.load * (1.0 + _LOAD_SIGMA * pattern)
        yield _moved(law, p, u, replace(tyres, load=load), weighed=True)


def _moved(law: str, p: Array, u: Array, tyres: WheelGeometry, weighed: bool = False) -> Array:
    """Body motion (n, 3) under a law; only where `weighed` do loads count for laws other than creep."""
    load = tyres.load if weighed or law == "creep" else np.ones(4)
    if law == "creep":
        return creep_motion(p, u, load, tyres.creep_ratio)
    if law != "dry-friction":
        wide = np.repeat(load, 2)
        return np.asarray(u @ np.linalg.solve(p.T @ (wide[:, None] * p), p.T * wide).T, dtype=np.float64)
    body, moving = np.zeros((len(u), 3)), np.any(u != 0.0, axis=1)
    body[moving] = least_dissipation(p, u[moving], load)
    return body
