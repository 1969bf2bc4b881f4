"""What the contract asks of a device at rest: to see that a robot stands, and to lose next to nothing."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

import hil
from hil.bench.contract import losses
from hil.bench.contract.device_under_test import Broken, Subject
from hil.bench.contract.losses import loses_next_to_nothing
from hil.bench.contract.pose_at_rest import sees_no_motion
from hil.core.clock import NS_PER_S
from hil.loop.timing import LoopStatistics


def reported(kind, altered, check=sees_no_motion):
    """What a check says of an emulated robot at rest whose samples are altered on their way."""
    with closing(hil.open_bench("emulated", seed=1)) as bench:
        bench.begin()
        device = bench.devices.get(kind)
        read = device.read
        device.read = lambda: tuple(one for s in read() for one in altered(s))
        return check(Subject(bench, kind, lambda: bench))


def drifting(velocity_m_s):
    def altered(sample):
        way_m = np.array(velocity_m_s) * sample.stamp.t_ns / NS_PER_S
        return (replace(sample, position_m=sample.position_m + way_m),)

    return altered


@pytest.mark.parametrize("kind", ["tracker", "mocap"])
def test_a_place_that_drifts_faster_than_a_camera_at_rest_may_is_reported_with_its_speed(kind):
    assert float(reported(kind, drifting((0.0, 0.003, 0.0))).removesuffix(" mm/s")) == pytest.approx(
        3.0, abs=0.5
    )
    for velocity_m_s in ((0.0, -0.008, 0.0), (0.0048, 0.0064, 0.0)):
        with pytest.raises(Broken, match=r"position moves at [78](\.\d)? mm/s; expected at most 5 mm/s"):
            reported(kind, drifting(velocity_m_s))


def test_a_few_places_do_not_show_that_it_stands():
    left = iter(range(19))
    with pytest.raises(Broken, match="19 usable places in 2 s; expected 20"):
        reported("mocap", lambda sample: (sample,) if next(left, None) is not None else ())


def test_a_sensor_without_a_position_is_not_asked():
    assert (
        reported("imu", lambda sample: (sample,))
        == reported("encoders", lambda s: (s,))
        == "reports no position"
    )


def from_s(begin_s):
    return lambda sample: (sample,) if sample.stamp.t_ns >= begin_s * NS_PER_S else ()


def test_what_a_device_does_not_deliver_while_it_starts_is_not_lost():
    assert "200 of 200 due are good" in reported("imu", from_s(0.5), loses_next_to_nothing)
    with pytest.raises(Broken, match=r"1[34]\d of 200 due are good \(7\d%\); expected \d\d% or more in 2 s"):
        reported("imu", from_s(1.2), loses_next_to_nothing)


def of_three_times(monkeypatch, *good, late=0):
    """What is said of a device in real time of whose 201 samples so many were good each time."""
    times = iter(good)
    monkeypatch.setattr(losses, "_watched", lambda subject: (next(times), 201.0))
    monkeypatch.setattr(losses, "idle_for", lambda config, seconds: LoopStatistics(cycles=100, late=late))
    with closing(hil.open_bench("emulated")) as bench:
        return loses_next_to_nothing(Subject(bench, "imu"))


@pytest.mark.parametrize("good", [(200,), (120, 200), (120, 0, 200)])
def test_in_real_time_the_best_of_three_times_counts(monkeypatch, good):
    assert of_three_times(monkeypatch, *good) == "200 of 201 due are good"


@pytest.mark.parametrize("good", [(160, 120, 40), (40, 120, 160)])
def test_the_best_of_them_is_reported_where_none_is_good_enough(monkeypatch, good):
    for late in (0, 3):
        with pytest.raises(Broken, match=r"160 of 201 due are good \(80%\)"):
            of_three_times(monkeypatch, *good, late=late)
    assert "too busy" in of_three_times(monkeypatch, *good, late=8)


def test_a_device_that_delivers_nothing_is_reported_on_a_busy_computer_too(monkeypatch):
    with pytest.raises(Broken, match=r"0 of 201 due are good \(0%\)"):
        of_three_times(monkeypatch, 0, 0, 0, late=50)
