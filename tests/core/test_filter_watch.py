"""A sensor with which the estimate had to begin anew is told of, and what that costs."""

import numpy as np

from hil.ring.filter_watch import FilterWatch
from hil.ring.supervisor import SafetyLimits, Supervisor
from hil.vocabulary.signals import RobotState


def state(t_ns=0, sigma_m=0.001, **figures):
    return RobotState(t_ns, np.zeros(3), np.zeros(3), np.eye(6) * sigma_m**2, figures)


def told(*states):
    watch, events = FilterWatch(), []
    for one in states:
        watch.judge(one, events)
    return events


def test_poses_that_were_refused_until_the_frame_began_anew_are_told_of_once():
    refused = state(5, 0.007, reanchored_tracker=1.0, rejected_tracker=40.0)
    (event,) = told(state(rejected_tracker=39.0), refused, refused)
    assert (event.t_ns, event.level, event.source) == (5, "warning", "tracker")
    assert (
        event.message == "did not fit what servos and IMU tell for long: the estimate is unsure by 7.0 mm now"
    )
    (event,) = told(state(reanchored_wheels=1.0, rejected_wheels=320.0))
    assert event.source == "servos"


def test_a_leap_that_refused_nothing_and_single_refusals_are_not():
    assert not told(state(reanchored_tracker=1.0), state(reanchored_tracker=2.0))
    assert not told(state(rejected_tracker=1.0), state(rejected_tracker=30.0), state())


def test_the_supervisor_tells_it_with_its_judgement_of_the_estimate():
    supervisor, refused = Supervisor(SafetyLimits()), state(reanchored_tracker=1.0, rejected_tracker=40.0)
    assert [event.source for event in supervisor.guard(refused, None)] == ["tracker"]
    supervisor.reset()
    assert [event.source for event in supervisor.guard(refused, None)] == ["tracker"]
