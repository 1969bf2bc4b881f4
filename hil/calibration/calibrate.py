"""`hil calibrate` as a function: fit, validate, analyse identifiability, and collect all in one result."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

from hil.calibration.against_nominal import AgainstNominal, against_nominal
from hil.calibration.common_damage import check_what_is_left
from hil.calibration.corrupt_recordings import corrupt
from hil.calibration.cross_validation import (
    Table,
    deployed,
    left_out,
    repeatability,
    repetition_numbers,
    score,
    table_of,
    unlike_repetitions,
)
from hil.calibration.evaluation import cost, track_all
from hil.calibration.excitation import Driven, check_geometry, driven
from hil.calibration.fitting import Fit, fit, twist_between
from hil.calibration.identifiability import Identifiability, StandardErrors, identifiability, standard_errors
from hil.calibration.model_choice import Candidate, Choice, apart_m, can_choose, candidates, choose
from hil.calibration.parameters import named, numbers
from hil.calibration.problem import PAPER, Setting
from hil.calibration.warnings import HARDLY, caveats, common_zero_rad, left_out_because, unexplained
from hil.core.clock import NS_PER_S, Clock
from hil.core.errors import DataError
from hil.core.geometry import Array
from hil.datasets.fit_blocks import Blocks, reduce_recordings
from hil.datasets.nominal_robot import Nominal, lever_m
from hil.datasets.wheel_log import Recording
from hil.datasets.wrong_signs import NO_MOTION, contradictions, is_at_rest
from hil.robot.kinematics import WheelGeometry
from hil.support.progress import WHOLE, Report, silent

_VALIDATION_BLOCK_S = 0.5


@dataclass(frozen=True)
class Calibration:
    """Result of a calibration; `to_json` gives the documented keys.

    `robot` is the nominal robot that errors before are computed with. `choice` shows how held-out recordings
    decided the forward model, None where they did not. `apart_m` is the distance, per metre of each motion,
    from the end of its path to the ends by other models that may be as right. All figures are of
    `recordings`, those that were fitted; `rejected` gives the reason why others were left out, by name.
    `wall_s` is the compute time of the calibration itself, `validation_s` that of judging the recordings and
    of the cross-validations.
    """

    method: str
    seed: int
    setting: Setting
    robot: Nominal
    fit: Fit
    spectrum: Identifiability
    intervals: StandardErrors
    choice: Choice | None
    cost_before: float
    cost_after: float
    validation: dict[str, Table]
    compared: AgainstNominal
    floor: dict[str, float]
    recordings: tuple[Recording, ...]
    warnings: tuple[str, ...]
    evaluations: int
    wall_s: float
    validation_s: float
    rejected: Mapping[str, str] = field(default_factory=dict)
    apart_m: Mapping[str, float] = field(default_factory=dict)

    @property
    def nominal(self) -> WheelGeometry:
        """Nominal geometry that the fit started from."""
        return self.robot.geometry

    @property
    def geometry(self) -> WheelGeometry:
        """The calibrated geometry."""
        return self.fit.geometry

    @cached_property
    def explains(self) -> bool:
        """Whether the result explains the recordings; if not, a warning gives what to look for.

        It does not where recordings that count contradict the nominal robot, nor where a parameter ended at
        the bound of its prior (ten standard deviations).
        """
        at_prior = bool(self.spectrum.at_bound) and self.fit.problem.setting.bounds is None
        weights = zip(self.recordings, self.fit.problem.weights, strict=True)
        counted = [one for one, weight in weights if weight > HARDLY]
        return not (unexplained(self.fit) or at_prior or contradictions(counted, self.nominal))

    def choice_in_words(self) -> tuple[str, ...]:
        """How the forward model was chosen, and how far models that may be as right end apart."""
        if self.choice is None:
            return ()
        sentence = self.choice.in_words()
        if not self.apart_m:
            return (sentence,)
        ways = ", ".join(f"{1e3 * apart:.1f} mm {motion}" for motion, apart in self.apart_m.items())
        rivals = ", ".join(rival.name for rival in self.choice.rivals)
        return (
            sentence,
            f"These explain the recordings as well: {rivals}. On a metre they end up to {ways} away.",
        )

    @cached_property
    def failure(self) -> str:
        """Why the result must not be used, but for one worse than nominal odometry; empty where it may be."""
        if not self.explains:
            return "the result does not explain the recordings"
        damaged = [one.name for one in self.recordings if one.problems]
        return f"damaged, and used as far as it can be read: {', '.join(damaged)}" if damaged else ""

    @property
    def driven(self) -> Driven:
        """Distance that the recordings drive in each direction."""
        return driven(self.fit.problem.blocks, self.nominal)

    @property
    def twist(self) -> Array:
        """The same result as a 3x3 correction C for nominal odometry and nominal inverse kinematics.

        Least squares of the fitted model's body motion on the nominal model's, over the recordings.
        """
        return twist_between(self.fit, self.nominal)

    def to_json(self) -> dict[str, object]:
        """JSON of `hil calibrate`; keys may be added, never renamed."""
        z = self.fit.solution.z
        half = self.intervals.quantile * self.intervals.std
        weights = zip(self.fit.problem.blocks.names, self.fit.problem.weights.tolist(), strict=True)
        return {
            "method": self.method,
            "setting": self.setting.name,
            "model": self.setting.model,
            "signal": self.setting.signal,
            "seed": self.seed,
            "recordings": len(self.recordings),
            "geometry": self.robot.to_json(),
            "driven_m": self.driven.to_json(),
            "cost_before": self.cost_before,
            "cost_after": self.cost_after,
            "objective": self.fit.solution.objective,
            "objective_before_polish": self.fit.solution.objective_before_polish,
            "polished": self.fit.solution.objective_before_polish is not None,
            "searched_dimensions": self.fit.solution.searched,
            "iterations": self.fit.solution.iterations,
            "converged": self.fit.solution.converged,
            "forward_models": None
            if self.choice is None
            else self.choice.to_json() | {"apart_m": dict(self.apart_m)},
            "parameters": named(z),
            "std": named(self.intervals.std),
            "interval_95": named(half),
            "at_bound": list(self.spectrum.at_bound),
            "unobservable": list(self.spectrum.unobservable),
            "determined_directions": self.spectrum.determined,
            "determined_without_contact_law": self.spectrum.determined_without_contact_law,
            "directions": list(self.spectrum.directions),
            "singular_values": self.spectrum.singular_values.tolist(),
            "information": self.spectrum.information.tolist(),
            "twist_correction": self.twist.tolist(),
            "twist_std": numbers(self.intervals.twist_std),
            "weights": dict(weights) | dict.fromkeys(self.rejected, 0.0),
            "rejected": list(self.rejected),
            "rejected_because": dict(self.rejected),
            "common_steering_zero_rad": common_zero_rad(self.fit),
            "validation": self.validation,
            "compared_with_nominal": self.compared.to_json(),
            "repeatability_m": {k: None if math.isnan(v) else v for k, v in self.floor.items()},
            "verdict": "FAIL" if self.failure or self.compared.worse else "PASS",
            "warnings": list(self.warnings),
            "evaluations": self.evaluations,
            "wall_s": self.wall_s,
            "validation_s": self.validation_s,
        }


def calibrate(
    recordings: Sequence[Recording],
    setting: Setting,
    clock: Clock,
    *,
    method: str = "lm",
    seed: int = 0,
    nominal: Nominal | None = None,
    choice: Choice | None = None,
    validate: bool = True,
    unusable: Mapping[str, str] | None = None,
    report: Report = silent,
) -> Calibration:
    """Fit the odometry parameters to recordings and judge the result; name and leave out corrupt ones.

    Args:
        recordings: runs with ground truth.
        setting: `PAPER`, `RECOMMENDED` or a variation.
        clock: clock for the reported compute time.
        method: `lm`, `interior-point`, `ga` or `pso`.
        seed: seed of the stochastic methods.
        nominal: nominal robot: start, prior mean, and basis of the errors before; the CAD model by default.
        choice: choice of setting and nominal, where this was done before.
        validate: True to run the cross-validations. Where the setting leaves the forward model open, they
            decide it by recordings left out of the fit; without them the fit's own residuals decide.
        unusable: recordings that could not be read, with the reason by name; the result lists them as well.
        report: progress callback (what, done, total).

    Raises:
        DataError: nothing to fit, two recordings of one name, a wheel signal that was not recorded, or the
            geometry of another robot.
    """
    if not recordings:
        raise DataError("", "no recordings", expected="at least one")
    if all(is_at_rest(one.wheel_angle_rad) for one in recordings):
        raise DataError(recordings[0].name, NO_MOTION)
    if twice := [name for name, n in Counter(r.name for r in recordings).items() if n > 1]:
        raise DataError("", f"several recordings are called {', '.join(twice)}", expected="names that differ")
    begin_ns = clock.now_ns()
    robot = nominal if nominal is not None else Nominal()
    bad = corrupt(recordings, robot)
    lacking = check_what_is_left(recordings, bad, unusable or {})
    recordings = [r for r in recordings if r.name not in bad]
    rejected = dict(unusable or {}) | bad
    if choice is None and validate and setting.choose_model and can_choose(recordings):
        choice = choose(recordings, candidates(setting, robot.geometry), report=report)
        setting, robot = choice.best.setting, replace(robot, geometry=choice.best.nominal)
    chosen_ns = clock.now_ns()
    cad = robot.geometry
    blocks = reduce_recordings(recordings, setting.block_s, setting.signal)
    check_geometry(blocks, robot)
    progress = partial(report, f"{method} generations")
    found = fit(blocks, setting, cad, method=method, seed=seed, progress=progress)
    setting = found.problem.setting
    evaluations = found.problem.evaluations
    spectrum = identifiability(found)
    before = track_all(recordings, cad, setting.model, setting.signal)
    after = track_all(recordings, found.geometry, setting.model, setting.signal)
    rivals = [_rival_fit(recordings, c) for c in choice.rivals] if choice is not None else []
    intervals = _intervals(found, cad, choice, rivals)
    fitted_ns = clock.now_ns()
    paper = _paper_fit(recordings, cad) if setting.name != PAPER.name else None
    applied = deployed(recordings, found.geometry, cad, twist_between(found, cad), setting)
    nothing, tables = score(recordings, cad, setting), dict[str, Table]()
    if validate:
        tables = {"nominal": nothing, "in_sample": applied.parameters, "deployed_as_twist": applied.twist}
        tables |= _cross_validation(recordings, blocks, cad, found, paper, choice, report)
    return Calibration(
        method=method,
        seed=seed,
        setting=setting,
        robot=robot,
        fit=found,
        spectrum=spectrum,
        intervals=intervals,
        choice=choice,
        cost_before=cost(before),
        cost_after=cost(after),
        validation=tables,
        compared=replace(
            against_nominal({"in_sample": applied.parameters} | tables, nothing, lever_m(cad)),
            lacking=tuple(lacking),
        ),
        floor=repeatability(recordings),
        recordings=tuple(recordings),
        warnings=(
            *left_out_because(rejected),
            *unlike_repetitions(before, lever_m(cad)),
            *caveats(recordings, found, spectrum, paper, tables, applied),
        ),
        evaluations=evaluations,
        wall_s=(fitted_ns - chosen_ns) / NS_PER_S,
        validation_s=(clock.now_ns() - fitted_ns + chosen_ns - begin_ns) / NS_PER_S,
        rejected=rejected,
        apart_m=apart_m(found, rivals, cad) if rivals else {},
    )


def _intervals(
    found: Fit, cad: WheelGeometry, choice: Choice | None, rivals: Sequence[Fit]
) -> StandardErrors:
    """Standard errors of a fit, widened by the differences to the fits of rival models."""
    own = standard_errors(found, cad)
    if choice is None or not rivals:
        return own
    others = [
        (choice.shares[rival.name], other.solution.z, standard_errors(other, cad))
        for rival, other in zip(choice.rivals, rivals, strict=True)
    ]
    return own.with_rival_models(found.solution.z, choice.shares[choice.best.name], others)


def _rival_fit(recordings: Sequence[Recording], rival: Candidate) -> Fit:
    setting = rival.setting
    return fit(reduce_recordings(recordings, setting.block_s, setting.signal), setting, rival.nominal)


def _paper_fit(recordings: Sequence[Recording], nominal: WheelGeometry) -> Fit | None:
    """Fit with the paper's setting on the same recordings, for comparison; None without wheel rates."""
    if not all(r.has_rates for r in recordings):
        return None
    setting = replace(PAPER, block_s=_VALIDATION_BLOCK_S)
    return fit(reduce_recordings(recordings, setting.block_s, setting.signal), setting, nominal)


def _fold_done(report: Report, what: str, before: int, in_all: int, done: int, total: int) -> None:
    """Report one more finished fold; `before` of `in_all` folds belong to other cross-validations."""
    report(WHOLE, before + done, in_all)
    report(what, done, total)


def _cross_validation(
    recordings: Sequence[Recording],
    blocks: Blocks,
    nominal: WheelGeometry,
    found: Fit,
    paper: Fit | None,
    choice: Choice | None,
    report: Report,
) -> dict[str, Table]:
    """Held-out errors for each kind of fold; reuses folds that the choice of the model has fitted."""
    tables: dict[str, Table] = {}
    runs = [(found.problem.setting, blocks, found.solution.z, "")]
    if paper is not None:
        runs.append((paper.problem.setting, paper.problem.blocks, paper.solution.z, "paper_"))
    folds: dict[str, Sequence[object]] = {
        "leave_one_repetition_out": repetition_numbers(blocks.motions),
        "leave_one_motion_out": blocks.motions,
    }
    folds = {name: groups for name, groups in folds.items() if len(set(groups)) > 1}
    before, total = 0, len(runs) * sum(len(set(groups)) for groups in folds.values())
    for kind, reduced, start, prefix in runs:
        for name, groups in folds.items():
            progress = partial(_fold_done, report, f"{prefix}{name}".replace("_", " "), before, total)
            if choice is not None and not prefix and list(groups) == list(choice.groups):
                tracks = list(choice.runs)
                progress(len(set(groups)), len(set(groups)))
            else:
                tracks = left_out(recordings, reduced, kind, nominal, start, groups, progress)
            tables[prefix + name] = table_of(tracks)
            before += len(set(groups))
    return tables
