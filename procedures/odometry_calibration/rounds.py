"""Rounds of an odometry calibration: drives with their parameters, fits, and the stop rule.

Each set of parameters is judged on the recordings that were driven with it. The newest set, not yet driven
with, is judged on repetitions left out of its fit. So no set is judged on data that it was fitted to.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hil.bench.loop_settings import geometry_of, nominal_of
from hil.calibration.calibrate import Calibration, calibrate
from hil.calibration.calibration_file import read_calibration
from hil.calibration.corrupt_recordings import corrupt
from hil.calibration.cross_validation import left_out, repetition_numbers
from hil.calibration.evaluation import Track, position_rmse, track_all
from hil.calibration.model_choice import Candidate, Choice, candidates, choose
from hil.calibration.problem import Setting
from hil.config.bench import BenchConfig
from hil.core.geometry import Array
from hil.datasets.wheel_log import Recording
from hil.procedure import Context
from hil.procedure.record_parts import known_parts
from hil.robot.kinematics import WheelGeometry

BY_EVIDENCE = "by evidence"
WORTH = 0.05
MOST_PLAY_RAD = 0.05
_ASSUMED_PLAY_RAD = math.radians(0.125)
_BOOTSTRAP = 2000


@dataclass(frozen=True)
class Odometry:
    """Wheel parameters and the forward model that uses them."""

    geometry: WheelGeometry
    model: str

    def tracks(self, recordings: Sequence[Recording]) -> list[Track]:
        """Return odometry and ground truth of recordings."""
        return track_all(recordings, self.geometry, self.model)


@dataclass(frozen=True)
class Driven:
    """Recordings and the parameters with which they were driven.

    Attributes:
        label: `round 1`, ..., `validation`.
        odometry: odometry during the drive; its parameters were also used for inverse kinematics.
    """

    label: str
    recordings: list[Recording]
    odometry: Odometry

    def tracks(self) -> list[Track]:
        """Return odometry as during the drive, and ground truth."""
        return self.odometry.tracks(self.recordings)

    def rmse_m(self) -> Array:
        """Return the position RMSE of odometry for each recording, m."""
        return np.array([position_rmse(t) for t in self.tracks()])


def odometry_in(file: Path | None, config: BenchConfig) -> Odometry:
    """Return the odometry of a calibration file; without a file that of the bench."""
    known = file or (Path(config.calibration) if config.calibration else None)
    if known is None:
        used = config.estimator.wheels.model
        return Odometry(geometry_of(config), "exact" if used == "equations" else used)
    found = read_calibration(known)
    return Odometry(found.geometry, found.model)


def known_play_rad(ctx: Context) -> float:
    """Return the play of the gears to each side, rad: half the backlash by `steering_zero`, or a default."""
    known = known_parts(ctx.source.config).get("backlash")
    if known is None or not known.figures:
        return _ASSUMED_PLAY_RAD
    return min(0.5 * max(figure.value for figure in known.figures.values()), MOST_PLAY_RAD)


def chosen(ctx: Context, rounds: Sequence[Driven], setting: Setting, model: str) -> Choice:
    """Return the forward model to fit, with loads and tyre ratio: the requested one, else by held-out data.

    The model has to be valid for drives with its own result, not for repetitions of the fitted data. So whole
    rounds are held out, or whole motions while there is one round.
    """
    nominal = nominal_of(ctx.source.config).geometry
    if model != BY_EVIDENCE:
        return Choice(Candidate(model, replace(setting, model=model, choose_model=False), nominal), {}, 1.0)
    recordings = [r for d in rounds for r in d.recordings]
    left_out, groups = held_out_together(rounds)
    bad = corrupt(recordings, nominal_of(ctx.source.config))
    good = [r for r in recordings if r.name not in bad]
    groups = [g for g, r in zip(groups, recordings, strict=True) if r.name not in bad] if groups else groups
    choice = choose(good, candidates(setting, nominal), groups=groups, report=ctx.progress)
    ctx.note(choice.in_words())
    rows = [[name, f"{1e3 * error_m:.2f}"] for name, error_m in sorted(choice.held_out_m.items(), key=_error)]
    ctx.table(
        f"Forward models, {ctx.where}",
        ["forward model", "error at the wheels (mm)"],
        rows,
        f"Each on {left_out} left out of its fit; {choice.best.name} is used.",
    )
    return choice


def held_out_together(rounds: Sequence[Driven]) -> tuple[str, list[object]]:
    """Return a text, and a label for each recording: its round, or its motion while there is one round.

    Two motions are too few to fit one without the other: then repetitions are held out.
    """
    if len(rounds) > 1:
        return "rounds", [d.label for d in rounds for _ in d.recordings]
    motions: list[object] = [r.motion for r in rounds[0].recordings]
    return ("motions", motions) if len(set(motions)) > 2 else ("repetitions", [])


def _error(row: tuple[str, float]) -> float:
    return row[1]


def improve(ctx: Context, recordings: Sequence[Recording], choice: Choice, method: str) -> Calibration:
    """Fit the recordings of all rounds so far, with the prior at the nominal robot.

    Rounds were driven with different parameters and at different positions in the backlash of the gears;
    together they determine more than the latest round (`docs/decisions/0007`).
    """
    paper = replace(nominal_of(ctx.source.config), geometry=choice.best.nominal)
    return calibrate(
        recordings,
        choice.best.setting,
        ctx.clock,
        method=method,
        seed=ctx.seed,
        nominal=paper,
        choice=choice,
        validate=False,
        report=ctx.progress,
    )


def improvement_bound(before: Array, after: Array, rng: np.random.Generator) -> float:
    """Return the lower end of the one-sided 97.5 % bootstrap interval of 1 - mean(after) / mean(before)."""
    picks = rng.integers(0, len(before), (_BOOTSTRAP, len(before)))
    gains = 1.0 - after[picks].mean(axis=1) / before[picks].mean(axis=1)
    return float(np.percentile(gains, 2.5))


def rise_beyond_chance(earlier: Array, later: Array, rng: np.random.Generator) -> float:
    """Return the rise of the mean RMSE (n,) from one round to a later one, beyond chance.

    It is the lower end of the one-sided 97.5 % bootstrap interval over recordings paired by motion and
    repetition; 0 if the rise may be chance.
    """
    picks = rng.integers(0, len(earlier), (_BOOTSTRAP, len(earlier)))
    rises = (later - earlier)[picks].mean(axis=1)
    return max(0.0, float(np.percentile(rises, 2.5)))


def tell_gain(ctx: Context, before: Driven, after: Driven) -> None:
    """Note how much smaller the error of the latest round is than that of the best earlier round.

    Recordings are paired by motion and repetition; the interval is over those pairs.
    """
    old, new = before.rmse_m(), after.rmse_m()
    low = improvement_bound(old, new, np.random.default_rng(ctx.seed))
    gain = f"better by at least {100 * low:.0f} %" if low > 0 else "no better than by chance"
    ctx.note(
        f"Driven position RMSE {1e3 * old.mean():.2f} mm in {before.label}, {1e3 * new.mean():.2f} mm in "
        f"{after.label}: {gain} (97.5 % confidence)."
    )


@dataclass(frozen=True)
class Foreseen:
    """Position RMSE (n,), m, of the newest round's recordings, by fits without them.

    Attributes:
        without_round: errors by the fit of all earlier rounds.
        without_repetition: errors by fits of all recordings except one repetition of this round.
    """

    without_round: Array
    without_repetition: Array

    def gain(self, seed: int) -> float:
        """Return the least relative reduction of the error by the round's data, with 97.5 % confidence."""
        rng = np.random.default_rng(seed)
        return improvement_bound(self.without_round, self.without_repetition, rng)


def foresee(rounds: Sequence[Driven], result: Calibration) -> Foreseen:
    """Return the errors of the newest round by fits without this round, or without a part of it."""
    recordings, blocks = result.recordings, result.fit.problem.blocks
    names = {r.name for r in rounds[-1].recordings}
    repetitions = repetition_numbers([r.motion for r in recordings if r.name in names])
    start, newest = result.nominal.vector(), len(repetitions)
    earlier = len(recordings) - newest
    foreseen = []
    for part in (["newest"] * newest, repetitions):
        groups = ["earlier"] * earlier + [*part]
        runs = left_out(recordings, blocks, result.setting, result.nominal, start, groups)
        foreseen.append(np.array([position_rmse(run) for run in runs[earlier:]]))
    return Foreseen(*foreseen)


def worth_another(ctx: Context, number: int, foreseen: Foreseen) -> bool:
    """Whether a further round may reduce the driven error by more than chance and 5 %.

    A further round is assumed to improve the fit as much as the newest one did. That is measured on held-out
    repetitions: their error with the rest of the round in the fit, against that without the round.
    """
    gain = foreseen.gain(ctx.seed)
    without, known = (1e3 * e.mean() for e in (foreseen.without_round, foreseen.without_repetition))
    verdict = "another round is worth its time" if gain > WORTH else "another round would gain too little"
    ctx.note(
        f"Held-out recordings of round {number}: {without:.2f} mm by a fit without that round, "
        f"{known:.2f} mm by fits without one repetition of it. A gain of at least {100 * gain:.0f} % "
        f"(97.5 % confidence): {verdict}."
    )
    return gain > WORTH
