"""What it costs that sensors are held against each other: processor time of a wall line with and without.

    python benchmarks/cost_of_checks.py --lines 3 --seconds 30

The same line up the wall, with EKF, supervisor and recording in virtual time, is driven by two processes: as
it is, and with the comparisons left out. Those are camera against wheels, gyro and motion capture, servos
against their external encoders, and the look at how well the filter's samples fit. The two take 40 control
cycles in turn, so that whatever else the machine does meets both, and a turn is compared with that of the
other for the same cycles. Printed as one JSON object: processor time of a cycle, the median of the turns'
ratios and the 95 % interval of that median; exit code 1 where the checks cost more than a twentieth.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from unittest.mock import patch

import numpy as np
from virtual_pair import TURN_CYCLES, Turns, in_turns, started, wall

from hil.loop.checks.filter_fit import FilterFit
from hil.loop.checks.mocap_estimate import MocapEstimate
from hil.loop.checks.motion_agreement import MotionCheck
from hil.loop.checks.steering_encoders import SteeringWatch
from hil.loop.checks.wheel_slip import WheelSlipCheck

MOST = 1.05
CHECKS = (
    (MotionCheck, "update"),
    (SteeringWatch, "judge"),
    (FilterFit, "judge"),
    (MocapEstimate, "judge"),
    (WheelSlipCheck, "judge"),
)
FORMS = ("with", "without")
UNSETTLED = 2
"""Turns at the start of a line that are not compared: the first cycles fill the windows."""


@contextmanager
def left_out() -> Iterator[None]:
    """A check that compares nothing."""

    def nothing(*given: object) -> tuple[()]:
        return ()

    with ExitStack() as stack:
        for kind, name in CHECKS:
            stack.enter_context(patch.object(kind, name, nothing))
        yield


def drive(form: str, seconds: float) -> None:
    """Drive the line in turns with the other form."""
    with ExitStack() as stack:
        if form == "without":
            stack.enter_context(left_out())
        wall(seconds, Turns().cycle)


def ratios(seconds: float) -> tuple[np.ndarray, dict[str, float]]:
    """Of the turns of one line, and the processor time of a cycle of each form, us."""
    command = [sys.executable, __file__, "--seconds", str(seconds), "--turns-of"]
    here = Path(__file__).resolve().parents[1]
    taken = in_turns({form: started([*command, form], here) for form in FORMS})
    settled = {form: np.array(times[UNSETTLED:]) for form, times in taken.items()}
    cost = {form: 1e6 * float(np.median(times)) / TURN_CYCLES for form, times in settled.items()}
    return settled["with"] / settled["without"], cost


def interval(values: np.ndarray) -> list[float]:
    """95 % interval of the median, by resampling."""
    rng = np.random.default_rng(0)
    medians = np.median(rng.choice(values, (2000, len(values))), axis=1)
    return [round(float(bound), 3) for bound in np.percentile(medians, (2.5, 97.5))]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--lines", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--turns-of", choices=FORMS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.turns_of:
        return drive(options.turns_of, options.seconds)
    found = [ratios(options.seconds) for _ in range(options.lines)]
    values = np.concatenate([one for one, _ in found])
    ratio = round(float(np.median(values)), 3)
    costs = {form: round(float(np.median([cost[form] for _, cost in found])), 1) for form in FORMS}
    figures = {"us_per_cycle": costs, "ratio": ratio, "interval": interval(values), "most": MOST}
    print(json.dumps({**figures, "turns": len(values)}, indent=1))
    sys.exit(1 if ratio > MOST else 0)


if __name__ == "__main__":
    main()
