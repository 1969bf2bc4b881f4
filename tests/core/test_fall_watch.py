"""A robot that has come off is weightless, one that slides is faster than it can drive: both are stopped."""

import math
from types import SimpleNamespace

import pytest

from hil.core.signals import Status
from hil.loop.checks.fall import FallCheck

LIGHTEST_M_S2, FASTEST_M_S = 4.0, 0.5


def felt(*forces, status=Status.OK):
    """Samples of an IMU that feels forces of these sizes, m/s^2, in any direction."""
    across = (math.sqrt(1 / 3),) * 3
    return SimpleNamespace(
        tracker=(), imu=[_sample(status, specific_force_m_s2=f, of=across) for f in forces]
    )


def seen(*speeds, status=Status.OK):
    """Samples of a camera that sees these speeds, m/s, sideways and down."""
    return SimpleNamespace(
        imu=(), tracker=[_sample(status, velocity_m_s=v, of=(0, -0.6, 0.8)) for v in speeds]
    )


def _sample(status, of, **named):
    ((name, size),) = named.items()
    values = [size * part for part in of]
    return SimpleNamespace(status=status, **{name: SimpleNamespace(tolist=lambda: values)})


def stops(*cycles, watch=None):
    """Reasons, by cycle."""
    watch = watch or FallCheck(LIGHTEST_M_S2, FASTEST_M_S)
    found = []
    for inputs in cycles:
        reasons = []
        watch.judge(inputs, lambda reason, text, reasons=reasons: reasons.append(reason))
        found.append(reasons)
    return found


@pytest.mark.parametrize(
    ("reported", "bad", "good", "reason"), [(felt, 3.9, 4.1, "adhesion"), (seen, 0.51, 0.49, "sliding")]
)
def test_three_samples_in_a_row_are_needed_and_enough(reported, bad, good, reason):
    assert stops(reported(bad), reported(bad), reported(bad)) == [[], [], [reason]]
    assert stops(reported(bad, bad, bad)) == [[reason]]
    assert stops(reported(bad, bad), reported(good), reported(bad, bad), reported(bad)) == [
        [],
        [],
        [],
        [reason],
    ]
    assert stops(*[reported(good)] * 9) == [[]] * 9
    assert stops(reported(bad, bad), reported(bad, status=Status.FROZEN)) == [[], []]
    assert stops(reported(bad, bad), reported(), reported(bad)) == [[], [], [reason]]


@pytest.mark.parametrize("reported", [felt, seen])
def test_a_new_run_knows_nothing_of_the_one_before(reported):
    bad = {felt: 0.0, seen: 2.0}[reported]
    watch = FallCheck(LIGHTEST_M_S2, FASTEST_M_S)
    stops(reported(bad, bad), watch=watch)
    watch.reset()
    assert stops(reported(bad, bad), watch=watch) == [[]]


def test_both_are_reported():
    both = SimpleNamespace(imu=felt(0.0, 0.0, 0.0).imu, tracker=seen(1.0, 1.0, 1.0).tracker)
    assert stops(both) == [["adhesion", "sliding"]]
