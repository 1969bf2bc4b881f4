"""The least-squares problem of a calibration: residuals, weights, prior or bounds, derivatives.

Two named settings. `paper`: squared errors in m^2 + rad^2, twelve parameters in a hard box of +-5 % around
nominal. `recommended`: sixteen parameters with a Gaussian prior instead of bounds, and residuals in units of
their spread. Each recording counts as a few effective observations, because twenty seconds of odometry error
are one random walk. A Cauchy weight per recording limits the influence of a bad one.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from hil.calibration.evaluation import turned_wheels
from hil.calibration.motion_models import Motions, make_model
from hil.calibration.residual_pass import Contacts, PassInputs, PassResults, load_pass, run_pass
from hil.core.geometry import Array
from hil.core.signals import WHEELS
from hil.datasets.fit_blocks import Blocks
from hil.robot.kinematics import WheelGeometry
from hil.robot.odometry import integrate, integrate_with_jacobian

Terms: TypeAlias = tuple[Array, Array, Array]
"""Cost (R,), J'e (R, m) and J'J (R, m, m), per recording."""
_EFFECTIVE_OBSERVATIONS = 3.0
_CAUCHY = 2.0 * 1.2
_REACH = 10.0
_BOUND_SLACK = 1e-3


class CostCache:
    """Cache of costs and terms at the last parameters, and work arrays; shared where only weights differ."""

    def __init__(self) -> None:
        self._costs: tuple[Array, Array] | None = None
        self._terms: tuple[Array, Terms] | None = None
        self._rows: tuple[Array, Array] | None = None

    def emptied(self) -> CostCache:
        """An empty cache with the same work arrays."""
        other = CostCache()
        other._rows = self._rows
        return other

    def keep_costs(self, z: Array, costs: Array) -> None:
        """Store the costs (R,) at parameters z (m,)."""
        self._costs = z.copy(), costs

    def keep_terms(self, z: Array, terms: Terms) -> None:
        """Store the terms at parameters z (m,)."""
        self._terms = z.copy(), terms

    def costs(self, z: Array) -> Array | None:
        """Stored costs (R,) at parameters z (m,); None where z is not the last one."""
        terms = self.terms(z)
        if terms is not None:
            return terms[0]
        return self._costs[1] if self._costs is not None and np.array_equal(self._costs[0], z) else None

    def terms(self, z: Array) -> Terms | None:
        """Stored terms at parameters z (m,); None where z is not the last one."""
        return self._terms[1] if self._terms is not None and np.array_equal(self._terms[0], z) else None

    def rows(self, shape: tuple[int, ...], size: int) -> tuple[Array, Array]:
        """Work arrays for errors (R, N, 3) and slopes (R, N, 3, m), initially 0."""
        if self._rows is None:
            self._rows = np.zeros(shape), np.zeros((*shape, size))
        return self._rows


PARAMETER_NAMES = tuple(f"{k}_{wheel}" for k in ("x_w", "y_w", "r", "delta0") for wheel in WHEELS)


@dataclass(frozen=True)
class Setting:
    """Parameters to fit, and the weights of the fit.

    Attributes:
        name: `paper`, `recommended` or `custom`.
        model, signal: forward model and wheel signal.
        offsets: True if the four steering zeros are free.
        sigma: residual scale (m, m, rad); None for the paper's plain sum.
        prior_length, prior_radius: relative standard deviations; prior_offset_rad absolute.
        bounds: relative half width of a hard box (for a steering zero in radians, since an angle of 0.05 rad
            moves a wheel's way by 5 % of its length); None for a prior instead.
        block_s: length of a block.
        robust: Cauchy weight per recording.
        by_motion: True if a recording stands out only where it differs from the others of its motion; a
            motion that the model explains badly as a whole is kept.
        steering_play_rad: play of a steering gear to each side. A wheel may stand on one side of it in all
            recordings of a motion; standard errors allow for that.
        tolerance: workshop tolerance over the prior's standard deviation. The prior is narrower, so that it
            holds parameters that the data do not show; standard errors include the full tolerance.
        choose_model: True to take `exact` instead of `dry-friction` where it explains the typical recording
            better.
    """

    name: str
    model: str
    signal: str
    offsets: bool
    sigma: tuple[float, float, float] | None
    prior_length: float
    prior_radius: float
    prior_offset_rad: float
    bounds: float | None
    block_s: float
    robust: bool
    choose_model: bool = False
    by_motion: bool = False
    steering_play_rad: float = 0.0
    tolerance: float = 2.0


PAPER = Setting("paper", "paper", "velocity", False, None, 0.05, 0.05, 0.02, 0.05, 0.1, False)
RECOMMENDED = Setting(
    "recommended",
    "dry-friction",
    "position",
    True,
    (0.004, 0.004, 0.006),
    0.01,
    0.01,
    float(np.radians(0.75)),
    None,
    0.3,
    True,
    True,
)
SETTINGS = {s.name: s for s in (PAPER, RECOMMENDED)}


class Problem:
    """Weighted residuals of z over blocks of recordings, plus the prior.

    Args:
        blocks: blocks of the recordings.
        setting: forward model, signal, priors or bounds.
        nominal: geometry to start from.

    Attributes:
        nominal: (m,) start and prior mean; `prior_std` (m,) its standard deviation.
        sizes: (m,) reference sizes of relative figures, see `sizes`.
        tyres: geometry with loads and creep ratio, which are not fitted.
        lower, upper: (m,) box of all methods; where the setting has none, ten prior standard deviations,
            which only senseless data reach.
        weights: (R,) weight of each recording; 1, or those of `with_weights`.
    """

    def __init__(self, blocks: Blocks, setting: Setting, nominal: WheelGeometry) -> None:
        self.blocks, self.setting, self.tyres = blocks, setting, nominal
        self.nominal = nominal.vector()[: 16 if setting.offsets else 12].copy()
        self.sizes = sizes(self.nominal)
        self.prior_std = prior_std(self.sizes, setting)
        half = _REACH * self.prior_std if setting.bounds is None else setting.bounds * self.sizes
        self.lower, self.upper = self.nominal - half, self.nominal + half
        self.weights = np.ones(len(blocks.names))
        self._count, self._known = [0], CostCache()
        self._model: Motions = make_model(setting.model, blocks.wheel_rad.reshape(-1, 8), nominal)
        self._scale = self._row_scale()

    def _row_scale(self) -> Array:
        """(R, 3) factor on each recording's residuals, without the recording's weight."""
        count = len(self.blocks.names)
        if self.setting.sigma is None:
            return np.full((count, 3), np.sqrt(self.blocks.block_s / 0.01))
        share = np.sqrt(_EFFECTIVE_OBSERVATIONS / np.maximum(self.blocks.compared, 1))
        return np.asarray(share[:, None] / np.array(self.setting.sigma), dtype=np.float64)

    @property
    def evaluations(self) -> int:
        """Number of times that poses were computed, by this problem and those derived from it."""
        return self._count[0]

    def counting_with(self, other: Problem) -> Problem:
        """Make this problem count its evaluations together with another's; returns itself."""
        self._count = other._count
        return self

    def with_weights(self, weights: Array) -> Problem:
        """The same problem with other weights (R,), one per recording; shares the warm start."""
        other = copy.copy(self)
        other.weights = weights
        return other

    def with_power(self, power: float) -> Problem:
        """The same problem with another friction exponent: 2 is least squares, 1 is Coulomb's law."""
        other = copy.copy(self)
        other._model = make_model(self.setting.model, self.blocks.wheel_rad.reshape(-1, 8), self.tyres, power)
        other._known = self._known.emptied()
        return other

    def errors(self, z: Array) -> Array:
        """Pose errors (R, N, 3): odometry minus truth, m, m, rad."""
        self._count[0] += 1
        return self.errors_of(self._model.motion(z))

    def errors_of(self, motion: Array) -> Array:
        """Pose errors (R, N, 3) for a given body motion (R N, 3) of all blocks."""
        r, n, _ = self.blocks.wheel_rad.shape
        poses = integrate(self.blocks.start, motion.reshape(r, n, 3))
        return np.asarray(poses[:, 1:] - self.blocks.truth, dtype=np.float64)

    def gram(self, z: Array, others: Array) -> Array:
        """Weighted Gram matrix (m + k + 1, m + k + 1) of derivatives by z, k further columns and the errors.

        Args:
            z: (m,) parameters.
            others: (R, N, 3, k) further columns.
        """
        errors, slopes = self.errors_and_jacobian(z)
        rows = np.concatenate([slopes, others, errors[..., None]], axis=-1)
        rows *= (self._row_factors() * np.sqrt(self.weights)[:, None, None])[..., None]
        flat = rows.reshape(-1, rows.shape[-1])
        return np.asarray(flat.T @ flat, dtype=np.float64)

    def errors_and_jacobian(self, z: Array) -> tuple[Array, Array]:
        """Pose errors (R, N, 3) and their derivatives (R, N, 3, m)."""
        self._count[0] += 1
        r, n, _ = self.blocks.wheel_rad.shape
        motion, jacobian = self._model.motion_jacobian(z)
        poses, slopes = integrate_with_jacobian(
            self.blocks.start, motion.reshape(r, n, 3), jacobian.reshape(3, len(z), r, n)
        )
        return poses[:, 1:] - self.blocks.truth, np.ascontiguousarray(slopes.transpose(2, 3, 0, 1))

    def _row_factors(self) -> Array:
        """(R, N, 3) factor on each residual, without the recording's weight; 0 where nothing is compared."""
        return np.asarray(self.blocks.mask[..., None] * self._scale[:, None], dtype=np.float64)

    def normal_terms(self, z: Array) -> Terms:
        """Cost (R,), J'e (R, m) and J'J (R, m, m), per recording and unweighted, without the prior."""
        known = self._known.terms(z)
        if known is None:
            errors, slopes = self._residuals(z, with_slopes=True)
            e, j = errors.reshape(len(errors), -1), slopes.reshape(len(errors), -1, len(z))
            jt = j.transpose(0, 2, 1)
            known = (e**2).sum(axis=1), (jt @ e[..., None])[..., 0], jt @ j
            self._known.keep_terms(z, known)
        return known

    def recording_costs(self, z: Array) -> Array:
        """Unweighted squared residuals (R,) of each recording."""
        known = self._known.costs(z)
        if known is None:
            known = (self._residuals(z)[0] ** 2).sum(axis=(1, 2))
            self._known.keep_costs(z, known)
        return known

    def _residuals(self, z: Array, with_slopes: bool = False) -> tuple[Array, Array]:
        """Scaled pose errors (R, N, 3), on request derivatives (R, N, 3, m); valid until the next call."""
        load_pass()
        self._count[0] += 1
        blocks, model, law = self.blocks, self._model, self._model.law
        errors, slopes = self._known.rows(self.blocks.truth.shape, len(z))
        contacts = Contacts(law.kind, law.load, law.power, law.ratio)
        driven = PassInputs(
            blocks.wheel_rad, blocks.start, blocks.truth, blocks.known, blocks.counts, self._scale
        )
        reckoned = PassResults(model.last, errors, slopes if with_slopes else slopes[:0])
        run_pass(contacts, z, turned_wheels(z), model.start(z), driven, reckoned)
        return errors, slopes

    def prior_cost(self, z: Array) -> float:
        """Squared prior residual of parameters z (m,); 0 under a hard box."""
        if self.setting.bounds is not None:
            return 0.0
        return float(np.sum(((z - self.nominal) / self.prior_std) ** 2))

    def prior_precision(self) -> Array:
        """(m,) diagonal of the prior's information; 0 under a hard box."""
        if self.setting.bounds is not None:
            return np.zeros_like(self.nominal)
        return np.asarray(1.0 / self.prior_std**2, dtype=np.float64)

    def objective(self, z: Array) -> float:
        """Value that the solvers minimise, at parameters z (m,)."""
        return float(self.weights @ self.recording_costs(z)) + self.prior_cost(z)

    def gradient_terms(self, z: Array) -> tuple[float, Array, Array]:
        """Objective, half its gradient (m,) and the Gauss-Newton matrix (m, m)."""
        costs, je, jj = self.normal_terms(z)
        precision = self.prior_precision()
        value = float(self.weights @ costs) + self.prior_cost(z)
        gradient = self.weights @ je + precision * (z - self.nominal)
        return value, gradient, np.einsum("r,rab->ab", self.weights, jj) + np.diag(precision)

    def cauchy_weights(self, z: Array) -> Array:
        """Cauchy weights (R,), from each recording's residual relative to the median recording."""
        rms = np.sqrt(self.recording_costs(z))
        typical = np.full(len(rms), np.median(rms))
        if self.setting.by_motion:
            motions = np.array(self.blocks.motions)
            own = [np.median(rms[motions == m]) for m in motions]
            typical = np.maximum(typical, own)
        return np.asarray(1.0 / (1.0 + (rms / np.maximum(_CAUCHY * typical, 1e-12)) ** 2), dtype=np.float64)

    def at_bound(self, z: Array) -> npt.NDArray[np.bool_]:
        """Which of the parameters z (m,) the box decides: within a thousandth of its width of a bound.

        The methods end at a bound, or just inside it.
        """
        slack = _BOUND_SLACK * (self.upper - self.lower)
        return np.asarray((z - self.lower <= slack) | (self.upper - z <= slack))

    def clip(self, z: Array) -> Array:
        """Parameters (m,) clipped to the box."""
        return np.asarray(np.clip(z, self.lower, self.upper), dtype=np.float64)


def sizes(nominal: Array) -> Array:
    """Reference sizes (m,) of relative figures: positions, radii, and one radian for steering zeros.

    A position near an axis of the body counts with half of the largest one, so that it is not held fixed.
    """
    positions = np.abs(nominal[:8])
    return np.concatenate(
        [np.maximum(positions, 0.5 * positions.max()), np.abs(nominal[8:12]), np.ones(len(nominal) - 12)]
    )


def prior_std(of: Array, setting: Setting) -> Array:
    """Prior standard deviation (m,) for parameters of the given `sizes` (m,)."""
    share = np.repeat([setting.prior_length, setting.prior_radius, setting.prior_offset_rad], [8, 4, 4])
    return np.asarray(share[: len(of)] * of, dtype=np.float64)


def make_setting(
    name: str, *, model: str | None = None, signal: str | None = None, bounds: float | None = None
) -> Setting:
    """A named setting with the user's overrides.

    Args:
        name: `recommended` or `paper`.
        model: forward model instead of the setting's.
        signal: wheel signal instead of the setting's.
        bounds: half width of a box, relative to the parameters' sizes, instead of a prior.
    """
    base = SETTINGS[name]
    if model is not None:
        block_s = 0.1 if model in ("exact", "paper") else RECOMMENDED.block_s
        base = replace(base, model=model, block_s=block_s, choose_model=False)
    if signal is not None:
        base = replace(base, signal=signal)
    if bounds is not None:
        base = replace(base, bounds=bounds)
    return base if base == SETTINGS[name] else replace(base, name="custom")
