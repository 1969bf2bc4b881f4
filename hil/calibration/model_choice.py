"""Chooses forward model, wheel loads and tyre ratio by recordings held out of the fit.

For the simulated plant of the emulated wall, creep under unequal loads predicts best; with another physics
and on the recordings of the real robot, dry friction does (`docs/calibration.md`). Residuals do not show
which: a wrong model fits its own recordings about as well. So every candidate is fitted without one
repetition at a time and judged on that repetition.

Repetitions of motions that are in the fit show only half of the error. Dry friction predicts wheels that
always contradict each other in the same way to half a millimetre, but to 4 to 6 mm once they are driven with
other parameters. A caller that will drive with the result can group what is left out together: all recordings
driven with one set of parameters, or all of one motion. This ranks the models as the next round does.

Each candidate has a probability: its law's before any data, times the likelihood of its errors on what was
left out. These are taken as independent, of one unknown size, from a distribution with heavier tails than the
normal one (generalised normal, exponent 1/2): a recording in which the robot slid, or one that a wrong model
predicts by luck, decides little alone. Recordings of one motion that are left out together are alike, and
count as one. Dry friction has half of the others' probability before: it also predicts repetitions of a
creeping robot well. Creep with another tyre ratio is a law of its own. Where no law is clearly the right one,
the simplest of those that are about as probable is taken. How often the choice is right on simulated sets
with a known law: `benchmarks/model_choice.py`.
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hil.calibration.cross_validation import left_out, repetition_numbers
from hil.calibration.evaluation import Track, position_rmse, rolled
from hil.calibration.fitting import Fit
from hil.calibration.problem import Setting
from hil.core.errors import DataError
from hil.core.geometry import Array
from hil.datasets.fit_blocks import reduce_recordings
from hil.datasets.nominal_robot import lever_m
from hil.datasets.wheel_log import Recording
from hil.robot.kinematics import WheelGeometry, twist_of_vectors
from hil.robot.odometry import integrate
from hil.support.progress import Report, silent

_MOST_FOLDS = 5
_BEFORE = {"exact": 1.0, "creep": 1.0, "dry-friction": 0.5}
"""Probability before any data, not normalised; from the simplest law to the least simple."""
_CLEARLY, _ALIKE, _RIVAL, _LEAST_M = 0.9, 0.5, 0.05, 1e-4
_EQUAL = (1.0, 1.0, 1.0, 1.0)
_ELSEWHERE = {
    "forwards": (1.0, 0.0, 0.0),
    "sideways": (0.0, 1.0, 0.0),
    "diagonally": (0.7, 0.7, 0.0),
    "on a circle": (1.0, 0.0, 2.0),
}
"""Motions of a metre: displacement in the body frame, m, m, rad."""
_STEPS = 100


@dataclass(frozen=True)
class Candidate:
    """A model to choose from: name, setting with forward model, geometry with loads and tyre ratio."""

    name: str
    setting: Setting
    nominal: WheelGeometry

    @property
    def law(self) -> str:
        """Name of the forward model."""
        return self.setting.model


@dataclass(frozen=True)
class Choice:
    """The candidate that predicts best, and the errors of all.

    Attributes:
        best: chosen candidate.
        held_out_m: mean error (position and heading, at the wheels) on recordings left out of the fit, by
            candidate.
        confidence: probability of the law of `best` among those of all candidates.
        rivals: other candidates with a probability of at least 0.05.
        shares: probability of each candidate, by name.
        groups: label of each recording; recordings with the same label were left out together.
        runs: odometry of each recording by the best candidate's fit without its group.
    """

    best: Candidate
    held_out_m: dict[str, float]
    confidence: float
    rivals: tuple[Candidate, ...] = ()
    groups: tuple[object, ...] = ()
    runs: tuple[Track, ...] = ()
    shares: Mapping[str, float] = field(default_factory=dict)

    def in_words(self) -> str:
        """One sentence for a report."""
        named, order = self.best.name, sorted(self.held_out_m.items(), key=lambda found: found[1])
        others = ", ".join(f"{name} {1e3 * m:.2f} mm" for name, m in order if name != named)
        unclear = "no clear choice, the simplest of the probable ones is taken"
        clear = "clear" if self.confidence > _CLEARLY else unclear
        return (
            f"Forward model by held-out recordings (errors at the wheels): {named}, "
            f"{1e3 * self.held_out_m[named]:.2f} mm; {others}. Its law is the right one of these with "
            f"a probability of {100 * self.confidence:.0f} %: {clear}."
        )

    def to_json(self) -> dict[str, object]:
        """Name of the best candidate, error by candidate, and the confidence."""
        return {"best": self.best.name, "held_out_rmse_m": self.held_out_m, "confidence": self.confidence}


def candidates(setting: Setting, nominal: WheelGeometry) -> tuple[Candidate, ...]:
    """Candidate models: exact; dry friction and creep with nominal and equal loads; creep also by tyre ratio.

    Args:
        setting: setting of the fit; its forward model is replaced.
        nominal: nominal geometry with loads by statics and tyre ratio.
    """
    creep = replace(setting, model="creep", choose_model=False)
    dry = replace(creep, model="dry-friction")
    by_statics, ratio = tuple(float(v) for v in nominal.load), nominal.creep_ratio
    found = {
        "exact": Candidate("exact", replace(creep, model="exact"), nominal),
        "dry-friction": Candidate("dry friction", dry, nominal.with_tyres(_EQUAL, ratio)),
    }
    if by_statics != _EQUAL:
        name = "dry friction, loads by statics"
        found[name] = Candidate(name, dry, nominal)
    known = "equal loads" if by_statics == _EQUAL else "loads by statics"
    for loads, words, ratios in ((by_statics, known, (ratio, 1.0, 0.4)), (_EQUAL, "equal loads", (1.0,))):
        for tyres in ratios:
            name = f"creep, {words}, tyre ratio {tyres:g}"
            found.setdefault(name, Candidate(name, creep, nominal.with_tyres(loads, tyres)))
    return tuple(found.values())


def can_choose(recordings: Sequence[Recording]) -> bool:
    """Whether recordings can be left out: at least one motion was repeated."""
    return len(set(repetition_numbers([r.motion for r in recordings]))) > 1


def choose(
    recordings: Sequence[Recording],
    among: Sequence[Candidate],
    *,
    groups: Sequence[Hashable] = (),
    report: Report = silent,
) -> Choice:
    """Fit every candidate without one group of recordings at a time, and judge it on the group left out.

    Args:
        recordings: recordings with at least two repetitions.
        among: candidates.
        groups: label of each recording; those of one label are left out together. By repetition where it is
            empty or has only one label.
        report: progress.

    Raises:
        DataError: nothing can be left out.
    """
    if len(set(groups)) < 2 and not can_choose(recordings):
        raise DataError("", "one repetition only: no forward model can be chosen", expected="at least two")
    if len(set(groups)) < 2:
        groups = [n % _MOST_FOLDS for n in repetition_numbers([r.motion for r in recordings])]
    runs, errors = [], []
    for done, candidate in enumerate(among):
        report("forward models", done, len(among))
        runs.append(_left_out(recordings, groups, candidate))
        errors.append([_at_wheels_m(run, candidate.nominal) for run in runs[-1]])
    report("forward models", len(among), len(among))
    alike = [(group, one.motion) for group, one in zip(groups, recordings, strict=True)]
    shares = probabilities(among, errors, alike)
    laws = {law: sum(s for c, s in zip(among, shares, strict=True) if c.law == law) for law in _BEFORE}
    law = _simplest(laws)
    first = max((k for k, c in enumerate(among) if c.law == law), key=lambda k: shares[k])
    rivals = tuple(c for k, c in enumerate(among) if k != first and shares[k] >= _RIVAL)
    named = {c.name: float(np.mean(m)) for c, m in zip(among, errors, strict=True)}
    by_name = {c.name: share for c, share in zip(among, shares, strict=True)}
    return Choice(among[first], named, laws[law], rivals, tuple(groups), tuple(runs[first]), by_name)


def _simplest(laws: Mapping[str, float]) -> str:
    """The simplest law of those at least half as probable as the most probable one, unless that is clear."""
    most = max(laws, key=lambda law: laws[law])
    if laws[most] > _CLEARLY:
        return most
    return next(law for law in _BEFORE if laws[law] >= _ALIKE * laws[most])


def probabilities(
    among: Sequence[Candidate], errors_m: Sequence[Sequence[float]], alike: Sequence[Hashable]
) -> list[float]:
    """Probability of each candidate by its errors on recordings left out of its fit.

    Args:
        among: candidates; those of one law and tyre ratio, which differ in the loads, share its probability.
        errors_m: error of each candidate on each recording, m.
        alike: label of each recording; those of one label have the same error of the model, and count as one.
    """
    same = [(c.law, c.nominal.creep_ratio if c.law == "creep" else 1.0) for c in among]
    before = np.log([_BEFORE[one[0]] / same.count(one) for one in same])
    share = np.array([1.0 / alike.count(label) for label in alike])
    typical_m = (np.sqrt(np.array(errors_m) + _LEAST_M) @ share / share.sum()) ** 2
    size = before - share.sum() * np.log(typical_m)
    shares = np.exp(size - size.max())
    found: list[float] = (shares / shares.sum()).tolist()
    return found


def _at_wheels_m(run: Track, nominal: WheelGeometry) -> float:
    """Root mean square error of a track, m; heading counts at the distance of the wheels."""
    heading_rad = float(np.sqrt(np.mean(run.error[:, 2] ** 2)))
    return float(np.hypot(position_rmse(run), lever_m(nominal) * heading_rad))


def apart_m(found: Fit, rivals: Sequence[Fit], nominal: WheelGeometry) -> dict[str, float]:
    """Distance between the end points of models that explain the recordings alike, on other motions.

    Args:
        found: fit of the chosen model.
        rivals: fits of models that may be as right.
        nominal: geometry that the wheels are commanded with.

    Returns:
        Largest distance from the chosen model's end point, m, for each motion of one metre.
    """
    by_nominal = nominal.projection() / np.repeat(nominal.radius_m, 2)[:, None]
    ends = {}
    for name, way in _ELSEWHERE.items():
        wheel_rad = np.tile(by_nominal @ np.array(way) / _STEPS, (_STEPS, 1))
        ends[name] = [_end_of(one, wheel_rad) for one in (found, *rivals)]
    return {
        name: max((float(np.hypot(*(e - own))) for e in others), default=0.0)
        for name, (own, *others) in ends.items()
    }


def _end_of(fit: Fit, wheel_rad: Array) -> Array:
    """End point (2,), m, of odometry by a fit, after wheel vectors (n, 8), rad."""
    u = rolled(fit.geometry.vector(), wheel_rad)
    motion = twist_of_vectors(fit.geometry, u, fit.problem.setting.model)
    return integrate(np.zeros(3), motion, "exponential")[-1, :2]


def _left_out(recordings: Sequence[Recording], groups: Sequence[object], candidate: Candidate) -> list[Track]:
    setting, nominal = candidate.setting, candidate.nominal
    blocks = reduce_recordings(recordings, setting.block_s, setting.signal)
    start = nominal.vector()[: 16 if setting.offsets else 12]
    return left_out(recordings, blocks, setting, nominal, start, groups)
