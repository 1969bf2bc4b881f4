"""Computes which parameters the data determine: singular values, directions, intervals.

The choice of a model adds uncertainty: other contact laws, wheel loads and tyres. A fit assumes one law, one
distribution of the loads and one kind of tyre. If another one were true, the parameters would be off although
the residuals look fine. The size of this error is linear in the difference between the models' body motions
and in the share of the other model; the residuals limit that share.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from hil.calibration.evaluation import rolled
from hil.calibration.fitting import Fit, twist_correction
from hil.calibration.problem import PARAMETER_NAMES, Problem
from hil.core.geometry import Array
from hil.robot.contact_laws import creep_motion, least_dissipation
from hil.robot.kinematics import WheelGeometry, projection

_LOAD_SIGMA = 0.15
_LOAD_PATTERNS = np.array([[1.0, -1.0, -1.0, 1.0], [1.0, 1.0, -1.0, -1.0], [1.0, -1.0, 1.0, -1.0]])
_TYRE_RATIOS = (0.4, 1.0)
_EFFECTIVE = 3.0
_LEAST_NOISE = 0.05
_PRIOR_ONLY = 0.9
_DEGREES_OF_FREEDOM = 8
_DIRECTION_NAMES = 3
_LEAST_KEPT = 1e-7
_LEAST_SHOWN = 1e-14


def model_freedom(fit: Fit, inverse: Array) -> Array:
    """Covariance (m, m) of the parameters due to the choice of the forward model.

    Each other model is mixed in with a share whose prior standard deviation is one. The shares are estimated
    from the residuals of the fit; their mean square is propagated to the parameters through the fit.

    Args:
        fit: fit to analyse.
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
    """Body motions (n, 3) of the same wheels by each of the other models."""
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
    """Body motion (n, 3) under a law; `weighed` makes loads count for laws other than creep."""
    load = tyres.load if weighed or law == "creep" else np.ones(4)
    if law == "creep":
        return creep_motion(p, u, load, tyres.creep_ratio)
    if law != "dry-friction":
        wide = np.repeat(load, 2)
        return np.asarray(u @ np.linalg.solve(p.T @ (wide[:, None] * p), p.T * wide).T, dtype=np.float64)
    body, moving = np.zeros((len(u), 3)), np.any(u != 0.0, axis=1)
    body[moving] = least_dissipation(p, u[moving], load)
    return body


@dataclass(frozen=True)
class Identifiability:
    """Spectrum of the fit's sensitivity to the parameters.

    Attributes:
        singular_values: RMS pose error (mm and mrad mixed) per 1 % of a length or 1 deg of an offset.
        information: data information over prior information per direction, largest first.
        determined: number of directions whose information exceeds the prior's.
        determined_without_contact_law: number of directions that plain kinematics determine; the others
            depend on the contact law of the forward model.
        directions: the determined directions in words.
        at_bound: parameters on the box, or so near to it that the box decides them.
        unobservable: parameters whose standard deviation the data reduce by less than a tenth.
        std_ratio: (m,) posterior over prior standard deviation.
    """

    singular_values: Array
    information: Array
    determined: int
    determined_without_contact_law: int
    directions: tuple[str, ...]
    at_bound: tuple[str, ...]
    unobservable: tuple[str, ...]
    std_ratio: Array


def identifiability(fit: Fit) -> Identifiability:
    """Analyse the Gauss-Newton matrix at the solution."""
    problem, z = fit.problem, fit.solution.z
    errors, slopes = problem.errors_and_jacobian(z)
    mask = problem.blocks.mask
    unit = np.where(np.arange(len(z)) < 12, 0.01 * problem.sizes, np.radians(1.0))
    flat = (slopes * unit * 1e3)[mask > 0].reshape(-1, len(z))
    spectrum = np.linalg.svd(flat.T @ flat / len(errors[mask > 0]), compute_uv=False) ** 0.5
    spread = problem.prior_std
    information = data_information(problem, z)
    whitened = spread[:, None] * information * spread[None, :]
    values, vectors = np.linalg.eigh(whitened)
    values, vectors = values[::-1], vectors[:, ::-1]
    posterior = np.linalg.inv(whitened + np.eye(len(z)))
    ratio = np.sqrt(np.diag(posterior))
    names = PARAMETER_NAMES[: len(z)]
    determined = int(np.count_nonzero(values > 1.0))
    return Identifiability(
        singular_values=np.asarray(spectrum, float),
        information=values,
        determined=determined,
        determined_without_contact_law=min(determined, _without_a_law(fit)),
        directions=tuple(_in_words(vectors[:, k] * spread, unit) for k in range(determined)),
        at_bound=tuple(n for n, b in zip(names, problem.at_bound(z), strict=True) if b),
        unobservable=tuple(n for n, r in zip(names, ratio, strict=True) if r > _PRIOR_ONLY),
        std_ratio=ratio,
    )


def _without_a_law(fit: Fit) -> int:
    """Number of determined directions when contradicting wheels are just averaged."""
    problem = fit.problem
    plain = Problem(problem.blocks, replace(problem.setting, model="exact"), problem.tyres)
    spread = problem.prior_std
    information = data_information(plain.with_weights(problem.weights), fit.solution.z)
    return int(np.count_nonzero(np.linalg.eigvalsh(spread[:, None] * information * spread) > 1.0))


def data_information(problem: Problem, z: Array) -> Array:
    """Information matrix (m, m) of the data alone, in units of the stated residual scales.

    The paper's cost has no scale. Its residuals are taken as 4 mm and 6 mrad with a few effective
    observations per recording, so that both settings can be compared with the same prior.
    """
    if problem.setting.sigma is not None:
        _, _, hessian = problem.gradient_terms(z)
        return np.asarray(hessian - np.diag(problem.prior_precision()), dtype=np.float64)
    _, slopes = problem.errors_and_jacobian(z)
    share = problem.blocks.mask * (3.0 / np.maximum(problem.blocks.compared, 1))[:, None]
    scaled = slopes / np.array([0.004, 0.004, 0.006])[:, None] * np.sqrt(share)[..., None, None]
    flat = scaled.reshape(-1, len(z))
    return np.asarray(flat.T @ flat, dtype=np.float64)


def _in_words(direction: Array, unit: Array) -> str:
    """Largest components of a direction, for example `+0.52 r_FL +0.49 r_BR -0.35 delta0_BL`."""
    parts = direction / unit
    parts = parts / np.linalg.norm(parts)
    order = np.argsort(-np.abs(parts))[:_DIRECTION_NAMES]
    return " ".join(f"{parts[i]:+.2f} {PARAMETER_NAMES[i]}" for i in order)


@dataclass(frozen=True)
class StandardErrors:
    """Standard errors, and the quantile for 95 % intervals.

    They combine the spread over recordings and motions, the prior, the steering play and the forward model.

    Attributes:
        covariance: covariance (m, m) of the parameters.
        twist_slopes: (m, 3, 3) derivative of the twist correction by each parameter.
        quantile: half width of a 95 % interval over its standard error.
    """

    covariance: Array
    twist_slopes: Array
    quantile: float

    @property
    def std(self) -> Array:
        """Standard errors of the parameters (m,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)), dtype=np.float64)

    @property
    def twist_std(self) -> Array:
        """Standard errors of the twist correction (3, 3)."""
        slopes = self.twist_slopes
        variance = np.einsum("aij,ab,bij->ij", slopes, self.covariance, slopes)
        return np.asarray(np.sqrt(variance), dtype=np.float64)

    def with_rival_models(
        self, z: Array, own: float, others: Sequence[tuple[float, Array, StandardErrors]]
    ) -> StandardErrors:
        """Standard errors where other forward models may be right: the spread about z of all of them.

        Args:
            z: (m,) fitted parameters.
            own: probability of the model that was fitted.
            others: probability, fitted parameters (m,) and standard errors of each other model.
        """
        total = own * self.covariance
        for probability, found, one in others:
            total = total + probability * (one.covariance + np.outer(found - z, found - z))
        return replace(self, covariance=total / (own + sum(probability for probability, _, _ in others)))


def standard_errors(fit: Fit, nominal: WheelGeometry) -> StandardErrors:
    """Standard errors by the spread over recordings and over motions, linearised at the solution.

    The naive (J'J)^-1 would be too small by up to fifty times: errors along a recording are one random walk.
    A systematic error of the forward model repeats in all recordings of a motion.
    """
    problem, z = fit.problem, fit.solution.z
    _, je, jj = problem.normal_terms(z)
    weights = problem.weights
    total = np.einsum("r,rab->ab", weights, jj) + np.diag(problem.prior_precision())
    total += 1e-9 * np.diag(np.diag(total))
    free = ~problem.at_bound(z)
    count, motions = len(weights), np.array(problem.blocks.motions)
    if count < 2 or not free.any():
        return StandardErrors(
            np.full((len(z), len(z)), np.nan), np.full((len(z), 3, 3), np.nan), float("nan")
        )
    inverse = np.asarray(np.linalg.pinv(total), dtype=np.float64)
    covariance = _prior_pull(problem, inverse) + _play(problem, inverse, jj) + model_freedom(fit, inverse)
    for groups in (np.arange(count), motions):
        moved = np.zeros((len(set(groups)), len(z)))
        for row, label in zip(moved, dict.fromkeys(groups), strict=True):
            share = np.where(groups == label, weights, 0.0)
            own = np.einsum("r,rab->ab", share, jj)[np.ix_(free, free)]
            row[free] = group_shift(total[np.ix_(free, free)], own, (share @ je)[free])
        covariance += moved.T @ moved
    return StandardErrors(
        covariance,
        _twist_slopes(problem, z, nominal),
        float(stdtrit(min(count - 1, _DEGREES_OF_FREEDOM), 0.975)),
    )


def group_shift(total: Array, own: Array, pull: Array) -> Array:
    """Contribution (m,) of a group of recordings to the spread of z; the covariance sums their squares.

    Leaving the group out would move z by (A - S)^-1 J'e, with total information A and the group's S. For a
    combination of parameters that only one group determines, this is far too large: there the fit follows the
    noise of the group. A^-1/2 (I - M)^-1/2 A^-1/2 J'e, with M = A^-1/2 S A^-1/2, has no bias where all errors
    are independent and alike (Bell and McCaffrey, "Bias reduction in standard errors for linear regression
    with multi-stage samples", 2002).

    Args:
        total: (m, m) information A.
        own: (m, m) information S of the group, a part of A.
        pull: (m,) J'e of the group.
    """
    values, vectors = np.linalg.eigh(total)
    shown = values > _LEAST_SHOWN * values.max()
    root = vectors[:, shown] / np.sqrt(values[shown])
    shares, ways = np.linalg.eigh(root.T @ own @ root)
    kept = np.sqrt(np.maximum(1.0 - shares, _LEAST_KEPT))
    return np.asarray(root @ ways @ (ways.T @ (root.T @ pull) / kept), dtype=np.float64)


def _prior_pull(problem: Problem, inverse: Array) -> Array:
    """Covariance (m, m) of z due to the uncertainty of the prior mean.

    The estimate is drawn towards the prior mean by A^-1 L (z0 - z), with prior precision L and total
    information A; z0 - z has covariance t^2 L^-1 with the workshop's tolerance t. This gives t^2 A^-1 L A^-1.
    """
    pulled = inverse @ np.diag(problem.prior_precision()) @ inverse
    return np.asarray(problem.setting.tolerance**2 * pulled, dtype=np.float64)


def play_shift(problem: Problem, inverse: Array, information: Array, own: Array) -> Array:
    """Change of z per radian of error in each steering angle in some recordings, shape (m, 4).

    Args:
        problem: weights of the recordings.
        inverse: (m, m) inverse of the total information.
        information: information (R, m, m) of each recording, unweighted.
        own: (R,) mask of these recordings.
    """
    share = np.einsum("r,rab->ab", problem.weights[own], information[own])
    return np.asarray(inverse @ share[:, 12:16], dtype=np.float64)


def _play(problem: Problem, inverse: Array, information: Array) -> Array:
    """Covariance (m, m) of z due to steering play, constant within the recordings of a motion.

    A steering angle that is off by d in one motion acts there like a zero that is off by d; d is uniform
    within the play.
    """
    size = len(inverse)
    covariance = np.zeros((size, size))
    play_rad = problem.setting.steering_play_rad
    if play_rad == 0.0 or size < 16:
        return covariance
    motions = np.array(problem.blocks.motions)
    for motion in dict.fromkeys(problem.blocks.motions):
        shift = play_shift(problem, inverse, information, motions == motion)
        covariance += play_rad**2 / 3.0 * shift @ shift.T
    return covariance


def _twist_slopes(problem: Problem, z: Array, nominal: WheelGeometry) -> Array:
    """Derivative (m, 3, 3) of the twist correction by each parameter."""
    step = 1e-3 * problem.prior_std
    return np.array(
        [
            (twist_correction(z + h, nominal) - twist_correction(z - h, nominal)) / (2 * h[k])
            for k, h in enumerate(np.diag(step))
        ]
    )
