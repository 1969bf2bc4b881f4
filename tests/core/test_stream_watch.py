"""A sensor whose samples come too seldom or too late is reported once; a healthy one never."""

import math

import numpy as np
import pytest

from hil.core.signals import Inputs, Stamp, Status, TrackerSample
from hil.loop.checks.sensor_rate import Healthy, SensorRate
from hil.loop.checks.sensor_status import SensorStatus

CYCLE_NS = 10_000_000
CAMERA = Healthy(200.0, 0.95, 0.07, 100.0)


def pose(t_ns, age_s, status=Status.OK):
    none = np.zeros(3)
    return TrackerSample(Stamp(t_ns - int(age_s * 1e9), t_ns, 0), none, np.zeros(4), none, none, 3, status)


def reported(per_cycle, *, age_s=0.025, healthy=CAMERA, cycles=600):
    """Times (s) and messages about a camera; poses per cycle and their age may be functions of the cycle."""
    watch, events = SensorRate({"tracker": healthy}), []
    for k in range(cycles):
        t_ns = k * CYCLE_NS
        age = age_s(k) if callable(age_s) else age_s
        watch.judge(Inputs(k, t_ns, tracker=(pose(t_ns, age),) * per_cycle(k)), events)
    return [(e.t_ns * 1e-9, e.message) for e in events]


def test_a_healthy_stream_and_a_lost_packet_are_not_worth_a_word():
    assert reported(lambda k: 2) == []
    assert reported(lambda k: 2 - (k % 25 == 0)) == []
    assert reported(lambda k: 2 - (k % 15 == 0), cycles=10) == []


def test_a_tenth_may_be_lost_on_a_busy_host():
    assert reported(lambda k: 2 - (k % 5 == 0)) == []


def test_a_quarter_that_is_lost_is_reported_once_until_it_is_over():
    (first,) = reported(lambda k: 2 - (k > 200 and k % 2 == 0))
    assert 2.0 < first[0] < 4.0
    assert "good samples a second instead of 200" in first[1]
    again = reported(lambda k: 2 - (k > 100 and k % 2 == 0 and not 300 < k < 500), cycles=900)
    assert len(again) == 2


def test_what_its_owner_chooses_is_learnt():
    unknown = Healthy(math.nan, 0.8, 0.07, 100.0)
    assert reported(lambda k: 1, healthy=unknown) == []
    ((at_s, message),) = reported(lambda k: int(k < 300 or k % 3 == 0), healthy=unknown)
    assert 3.0 < at_s < 5.0
    assert int(message.split()[1]) < 68
    assert message.endswith("instead of 101")


@pytest.mark.parametrize(("age_s", "count"), [(0.06, 0), (0.12, 1)])
def test_samples_that_come_late_are_reported(age_s, count):
    found = reported(lambda k: 2, age_s=lambda k: 0.02 if k < 250 else age_s)
    assert len(found) == count
    assert all(f"{age_s:.3f} s old" in message for _, message in found)


def test_a_single_late_one_is_not():
    assert reported(lambda k: 2, age_s=lambda k: 0.3 if k % 7 else 0.02) == []


def test_a_loop_that_is_late_itself_blames_no_device():
    """A busy host has every second cycle only: half of what is asked for in each is lost."""
    watch, events = SensorRate({"tracker": CAMERA}), []
    for k in range(0, 600, 2):
        watch.judge(Inputs(k, k * CYCLE_NS, tracker=(pose(k * CYCLE_NS, 0.2),)), events)
    assert events == []


def test_a_camera_that_is_not_sure_of_itself_yet_is_left_in_peace():
    watch, events = SensorRate({"tracker": CAMERA}), []
    for k in range(400):
        t_ns = k * CYCLE_NS
        status = Status.LOW_CONFIDENCE if k < 60 else Status.OK
        watch.judge(Inputs(k, t_ns, tracker=(pose(t_ns, 0.02, status),) * 2), events)
    assert events == []


def gaps(given, gap_s=0.1):
    """Cycles in which a camera is asked to be silent, that must not be so for 2 s."""
    watch, events = SensorStatus({"tracker": 2.0}, {"tracker": gap_s}), []
    for k, there in enumerate(given):
        t_ns = k * CYCLE_NS
        watch.judge(Inputs(k, t_ns, tracker=(pose(t_ns, 0.02),) * there), events)
    return [e.t_ns // CYCLE_NS for e in events if "stale" in e.message], watch


def test_a_gap_is_reported_long_before_a_silence_that_counts():
    found, watch = gaps([1] * 20 + [0] * 60)
    assert found == [30]
    assert watch.silence("tracker", 79 * CYCLE_NS) == ""
    found, watch = gaps([1] * 20 + [0] * 250)
    assert found == [30]
    assert watch.silence("tracker", 269 * CYCLE_NS).startswith("for 2.5 s")


def test_gaps_that_come_again_and_again_are_reported_once_a_second():
    found, _ = gaps(([1] * 20 + [0] * 30) * 10)
    assert len(found) == 5


def test_who_has_not_been_heard_yet_is_waited_for():
    found, _ = gaps([0] * 100 + [1] * 5)
    assert found == []
    found, _ = gaps([0] * 300)
    assert found == [201]
