"""What tells places has to see a robot at rest stand still: what the contract passes, and what it names."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

import hil
from hil.bench.contract.stillness import sees_no_motion
from hil.bench.contract.subject import Broken, Subject
from hil.vocabulary.clock import NS_PER_S


def told(kind, altered):
    """What the check says of an emulated robot at rest whose samples are altered on their way."""
    with closing(hil.open_bench("emulated", seed=1)) as bench:
        bench.begin()
        device = bench.rig.get(kind)
        read = device.read
        device.read = lambda: tuple(one for s in read() for one in altered(s))
        return sees_no_motion(Subject(bench, kind))


def drifting(velocity_m_s):
    def altered(sample):
        way_m = np.array(velocity_m_s) * sample.stamp.t_ns / NS_PER_S
        return (replace(sample, position_m=sample.position_m + way_m),)

    return altered


@pytest.mark.parametrize("kind", ["tracker", "mocap"])
def test_a_place_that_drifts_faster_than_a_camera_at_rest_may_is_told_with_its_speed(kind):
    assert float(told(kind, drifting((0.0, 0.003, 0.0))).removesuffix(" mm/s")) == pytest.approx(3.0, abs=0.5)
    for velocity_m_s in ((0.008, 0.0, 0.0), (0.0, -0.008, 0.0), (0.0048, 0.0064, 0.0)):
        with pytest.raises(Broken, match=r"the robot moves at [78](\.\d)? mm/s .*; expected at most 5 mm/s"):
            told(kind, drifting(velocity_m_s))


def test_a_few_places_do_not_show_that_it_stands():
    left = iter(range(19))
    with pytest.raises(Broken, match="19 usable places in 2 s; expected 20"):
        told("mocap", lambda sample: (sample,) if next(left, None) is not None else ())


def test_what_tells_no_place_is_not_asked():
    assert told("imu", lambda sample: (sample,)) == told("encoders", lambda s: (s,)) == "tells no place"
