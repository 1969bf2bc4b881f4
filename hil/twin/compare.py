"""Compares recordings of a robot with what the emulated robot makes of their commands.

Figures: the end error of nominal odometry, by motion, with the interval in which 90 % of emulated runs lie
(each with a robot of its own, drawn by seed). Signals: how well a classifier tells windows of both apart, on
motions that it has not seen, and as a control repetitions of the recorded robot against each other.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.calibration.evaluation import track_all
from hil.config.bench import BenchConfig
from hil.core.errors import DataError, UsageError
from hil.core.geometry import Array
from hil.datasets.wheel_log import Recording
from hil.support.progress import Report, silent
from hil.twin.features import GROUPS, WINDOW_S, windows
from hil.twin.repeat import repeated
from hil.twin.two_sample_test import separation

LIMIT, CONTROL = 0.70, 0.60
"""Largest AUC of a group of signals that passes, where the control is not above the second."""

_NEEDED = ("servos", "mocap")
_REACH_M = 1.0
_FIGURES = (("ahead", "mm", 1e3), ("left", "mm", 1e3), ("heading", "deg", math.degrees(1.0)))
_T95 = (math.inf, 6.314, 2.920, 2.353, 2.132, 2.015, 1.943, 1.895, 1.860, 1.833)
"""Quantiles 0.95 of Student's t by degrees of freedom, from 0 on (1.833 from 9 on)."""


@dataclass(frozen=True)
class Figure:
    """End error of nominal odometry of one motion in one direction.

    Attributes:
        motion, name, unit: what it is.
        recorded: mean of the recorded runs.
        low, high: interval in which 90 % of emulated runs lie; infinite for a single run.
    """

    motion: str
    name: str
    unit: str
    recorded: float
    low: float
    high: float

    @property
    def inside(self) -> bool:
        """Whether the recorded mean lies in the interval."""
        return self.low <= self.recorded <= self.high


@dataclass(frozen=True)
class Signals:
    """A group of signals: AUC of recorded against emulated windows, and of recorded repetitions."""

    group: str
    auc: float
    control: float

    @property
    def alike(self) -> bool | None:
        """Whether the group passes; None where recorded repetitions differ too much or lack."""
        if not (self.control <= CONTROL and math.isfinite(self.auc)):
            return None
        return self.auc <= LIMIT


@dataclass(frozen=True)
class Comparison:
    """Result of a comparison.

    Attributes:
        figures: figures by motion.
        signals: groups of signals.
        recorded, emulated: numbers of windows.
    """

    figures: tuple[Figure, ...]
    signals: tuple[Signals, ...]
    recorded: int
    emulated: int

    @property
    def passed(self) -> bool:
        """Whether all figures lie in their intervals, and no group of signals fails."""
        return all(f.inside for f in self.figures) and all(s.alike is not False for s in self.signals)

    def to_json(self) -> dict[str, Any]:
        """The result as plain data; values that are not known are null."""
        return {
            "verdict": "PASS" if self.passed else "FAIL",
            "windows": {"recorded": self.recorded, "emulated": self.emulated},
            "figures": [
                {**vars(f), "low": _known(f.low), "high": _known(f.high), "inside": f.inside}
                for f in self.figures
            ],
            "signals": [
                {"group": s.group, "auc": _known(s.auc), "control": _known(s.control), "alike": s.alike}
                for s in self.signals
            ],
        }


def compare(
    recordings: Sequence[Recording], config: BenchConfig, seed: int = 0, report: Report = silent
) -> Comparison:
    """Emulate a run for each recording, and compare.

    Args:
        recordings: runs of one robot with velocity register and ground truth, best several of each motion.
        config: bench with emulated servos and motion capture; of its devices only these two are used.
        seed: seed of the first emulated run; each further one has the next.
        report: progress.

    Raises:
        UsageError: the bench lacks one of the two, or has it as a real device.
        DataError: recordings of a twist or without velocity register, or without even motion.
        SafetyStop, DeviceError: the emulated robot was stopped.
    """
    for one in recordings:
        if one.of_twist:
            raise DataError(
                one.sources[0],
                "gives a twist, and a twist cannot be compared: what is compared is measured at the wheels",
                expected="wheel angles and rates ([wheels] of --topics)",
                remedy="`hil replay RECORDING --topics FILE` compares a twist with the ground truth",
            )
        if not one.has_rates:
            raise DataError(one.sources[0], "has no velocity register of the wheels", expected="wheel rates")
    settings = _settings(config, recordings)
    emulated = []
    for k, one in enumerate(recordings):
        emulated.append(repeated(one, settings, seed + k))
        report("emulating", k + 1, len(recordings))
    return compared(recordings, emulated)


def compared(recordings: Sequence[Recording], emulated: Sequence[Recording]) -> Comparison:
    """Compare recordings with emulated runs of the same commands, in the same order.

    Raises:
        DataError: no window of even motion in one of them.
    """
    real, made = _by_motion(recordings), _by_motion(emulated)
    numbers = [sum(len(found) for runs in side.values() for found in runs) for side in (real, made)]
    if not all(numbers):
        raise DataError(
            recordings[0].sources[0] if recordings[0].sources else recordings[0].name,
            "has no stretch in which all wheels turn evenly",
            expected=f"{WINDOW_S:g} s at one speed",
        )
    signals = tuple(
        Signals(
            group,
            separation(_windows(real, group, slice(None)), _windows(made, group, slice(None))),
            separation(_windows(real, group, slice(0, None, 2)), _windows(real, group, slice(1, None, 2))),
        )
        for group in GROUPS
    )
    return Comparison(_figures(recordings, emulated), signals, *numbers)


def _settings(config: BenchConfig, recordings: Sequence[Recording]) -> BenchConfig:
    """The bench with servos and capture alone, at the recorded rate, bounded by the recorded path."""
    lacking = [name for name in _NEEDED if name not in config.emulated()]
    if lacking:
        raise UsageError(
            f"{config.name} has no emulated {' and no emulated '.join(lacking)}",
            expected='servos and motion capture with backend = "emulated"',
            remedy="use --bench emulated_floor",
        )
    rate_hz = float(np.median([1.0 / np.median(np.diff(one.t_s)) for one in recordings]))
    return config.model_copy(
        update={
            **{name: None for name in config.devices() if name not in _NEEDED},
            "loop": config.loop.model_copy(update={"rate_hz": round(rate_hz, 1)}),
            "safety": config.safety.model_copy(update={"tracking_error_limit_m": _REACH_M}),
        }
    )


Runs = dict[str, list[list[dict[str, Array]]]]


def _by_motion(recordings: Sequence[Recording]) -> Runs:
    """Windows of each run, by motion."""
    out: Runs = defaultdict(list)
    for one in recordings:
        out[one.motion].append(list(windows(one)))
    return out


def _windows(runs: Runs, group: str, of: slice) -> dict[str, list[Array]]:
    """Features of a group by motion, of some of the runs."""
    return {name: [w[group] for found in every[of] for w in found] for name, every in runs.items()}


def _figures(recordings: Sequence[Recording], emulated: Sequence[Recording]) -> tuple[Figure, ...]:
    ends = [_ends(side) for side in (recordings, emulated)]
    out = []
    for motion, real in ends[0].items():
        made = ends[1][motion]
        n = len(made)
        t = _T95[min(n - 1, len(_T95) - 1)]
        middle = np.mean(made, axis=0)
        spread = np.std(made, axis=0, ddof=1) if n > 1 else np.full(3, math.inf)
        reach = t * spread * math.sqrt(1.0 + 1.0 / n) if n > 1 else spread
        for k, (name, unit, factor) in enumerate(_FIGURES):
            mean = factor * float(np.mean(real, axis=0)[k])
            low, high = (factor * float(middle[k] + way * reach[k]) for way in (-1.0, 1.0))
            out.append(Figure(motion, name, unit, mean, low, high))
    return tuple(out)


def _ends(recordings: Sequence[Recording]) -> dict[str, Array]:
    """End errors (n, 3) of nominal odometry in the body axes of the start, m, m, rad, by motion."""
    out: dict[str, list[Array]] = defaultdict(list)
    for one, track in zip(recordings, track_all(recordings, recordings[0].nominal.geometry), strict=True):
        x, y, theta = track.error[-1]
        c, s = np.cos(track.truth[0, 2]), np.sin(track.truth[0, 2])
        out[one.motion].append(np.array([c * x + s * y, c * y - s * x, theta]))
    return {motion: np.stack(found) for motion, found in out.items()}


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
