"""Columns in another unit: every set of them is named as it was made, and nothing else."""

import itertools
import math

import numpy as np
import perfect_robot as perfect
import pytest

from hil.datasets.cleaning import Log
from hil.datasets.wheel_log import build_recording
from hil.datasets.wrong_units import UnitError

DEGREE = math.pi / 180.0
TO_SI = {"t": 1e-3, "phi": DEGREE, "delta": DEGREE, "w": math.tau / 60.0, "x, y": 1e-3, "theta": DEGREE}
SETS = [units for number in range(1, 7) for units in itertools.combinations(TO_SI, number)]


@pytest.fixture(scope="module")
def drive():
    return perfect.drive()


def logs(drive, wrong):
    """Logs of the drive with some columns in another unit."""
    by = {name: 1.0 / TO_SI[name] if name in wrong else 1.0 for name in TO_SI}
    wheels = np.column_stack([by["phi"] * drive.phi, by["delta"] * drive.delta, by["w"] * drive.rate])
    pose = drive.pose * (by["x, y"], by["x, y"], by["theta"])
    return Log(by["t"] * drive.t_s, wheels), Log(by["t"] * drive.truth_s, pose)


@pytest.mark.parametrize("wrong", SETS, ids="+".join)
def test_each_set_is_named(drive, wrong):
    with pytest.raises(UnitError) as caught:
        build_recording("curve", *logs(drive, wrong))
    assert caught.value.units == pytest.approx({name: TO_SI[name] for name in wrong})
    assert len(caught.value.problems) == len(wrong)


def test_right_units_are_read(drive):
    assert build_recording("curve", *logs(drive, ())).has_truth


@pytest.mark.parametrize("times", [0.3, 0.4, 2.6, 3.0, 4.0])
def test_wheels_of_another_size_are_no_two_units(times):
    """On a line, degrees and centimetres at once are radians and metres of wheels 1.7 times as large.

    Nor is x then a height, which would not follow the wheels by one factor.
    """
    t_s = np.arange(0.0, 102.0, 0.016)
    way_m = 0.2 * np.clip(t_s - 1.0, 0.0, 100.0)
    wheels = np.zeros((len(t_s), 8))
    wheels[:, :4] = way_m[:, None] / (times * perfect.RADIUS_M)
    pose = np.column_stack([way_m, np.zeros((len(t_s), 2))])
    assert build_recording("line", Log(t_s, wheels), Log(t_s, pose)).has_truth
