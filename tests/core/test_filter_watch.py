"""A sensor with which the estimate had to begin anew is reported, and what that costs."""

import numpy as np
import pytest
from supervised import Supervised

from hil.core.errors import SafetyStop
from hil.core.signals import WHEELS, Inputs, Measurements, RobotState, Stamp, WheelMeasurement
from hil.loop.checks.filter_fit import FilterFit
from hil.loop.safety_limits import SafetyLimits


def state(t_ns=0, sigma_m=0.001, **figures):
    return RobotState(t_ns, np.zeros(3), np.zeros(3), np.eye(6) * sigma_m**2, figures)


def reported(*states):
    watch, events = FilterFit(), []
    for one in states:
        watch.judge(one, events)
    return events


def test_poses_that_were_refused_until_the_frame_began_anew_are_reported_once():
    refused = state(5, 0.007, reanchored_tracker=1.0, rejected_tracker=40.0)
    (event,) = reported(state(rejected_tracker=39.0), refused, refused)
    assert (event.t_ns, event.level, event.source) == (5, "warning", "tracker")
    assert event.message == "did not fit servos and IMU for long: the estimate is unsure by 7.0 mm now"
    (event,) = reported(state(reanchored_wheels=1.0, rejected_wheels=320.0))
    assert event.source == "servos"


def test_a_leap_that_refused_nothing_and_single_refusals_are_not():
    assert not reported(state(reanchored_tracker=1.0), state(reanchored_tracker=2.0))
    assert not reported(state(rejected_tracker=1.0), state(rejected_tracker=30.0), state())


def test_the_supervisor_reports_it_with_its_judgement_of_the_estimate():
    supervisor, refused = Supervised(SafetyLimits()), state(reanchored_tracker=1.0, rejected_tracker=40.0)
    assert [event.source for event in supervisor.guard(refused, None)] == ["tracker"]
    supervisor.reset()
    assert [event.source for event in supervisor.guard(refused, None)] == ["tracker"]


def misfits(*means):
    return [state(k, nis_mean_tracker=mean, innovation_tracker_m=1e-3 * mean) for k, mean in enumerate(means)]


def test_a_camera_that_fits_badly_on_the_whole_is_reported_once_and_again_after_a_calm():
    events = reported(*misfits(1.0, 1.2, 2.0, 2.6, 3.0, 2.4, 2.7, 1.0, 2.6))
    assert [(event.t_ns, event.source) for event in events] == [(3, "tracker"), (8, "tracker")]
    assert "mean NIS 2.6" in events[0].message
    assert events[0].message.endswith("unsure by 2.6 mm more")
    assert not reported(*misfits(1.0, 1.2, 2.4, 1.6, 2.4))


def test_what_fits_badly_widens_the_covariance_in_the_next_cycle_only():
    supervisor = Supervised(SafetyLimits(stale_s={}))
    for one in misfits(1.0, 2.0, 2.6):
        supervisor.guard(one, None)
    for inflated_m in (pytest.approx(0.0026), 0.0):
        supervisor.check(Inputs(0, 0), Measurements(0, 0))
        assert supervisor.inflation == (inflated_m, 0.0)


def test_poses_that_are_refused_in_a_row_and_the_frame_after_them_are_no_misfit():
    row = [state(k, nis_mean_tracker=3.0 + k, rejected_tracker=1.0 + k) for k in range(5)]
    after = [
        state(10 + k, nis_mean_tracker=8.0 - k, rejected_tracker=6.0, reanchored_tracker=1.0)
        for k in range(8)
    ]
    assert [event.message[:11] for event in reported(*row, row[-1], *after)] == ["did not fit"]


def test_the_first_poses_of_a_run_may_be_those_that_do_not_fit():
    watch, events = FilterFit(), []
    assert watch.take_inflation() == (0.0, 0.0)
    watch.judge(misfits(2.6)[0], events)
    assert [event.message.rpartition(" by ")[2] for event in events] == ["2.6 mm more"]
    assert watch.take_inflation() == (pytest.approx(0.0026), 0.0)
    assert watch.take_inflation() == (0.0, 0.0)


FORMER = {
    "refusals": [state(0, rejected_tracker=7.0, reanchored_wheels=1.0, rejected_wheels=9.0)],
    "a misfit": misfits(1.0, 2.0, 3.0),
    "a far innovation": [state(0, nis_mean_tracker=2.0, innovation_tracker_m=0.5)],
    "a mean": misfits(2.6),
}


@pytest.mark.parametrize("former", FORMER.values(), ids=FORMER)
@pytest.mark.parametrize(
    "run",
    [
        misfits(2.6, 3.0),
        [state(1, 0.007, reanchored_wheels=1.0, rejected_wheels=9.0)],
        [state(1, 0.007, reanchored_tracker=1.0, rejected_tracker=7.0)],
        [state(0)],
    ],
)
def test_a_run_is_judged_as_the_first_one_whatever_was_before_it(former, run):
    found = []
    for before in ([], former):
        watch, events = FilterFit(), []
        for one in before:
            watch.judge(one, [])
        watch.reset()
        off = [watch.take_inflation()]
        for one in run:
            watch.judge(one, events)
            off.append(watch.take_inflation())
        found.append((events, off))
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ("refused", "nis", "stops_in"),
    [((1, 1, 2, 1), 7.0, 20), ((0, 2, 2, 2), 150.0, None), ((2, 2, 2, 2), 5.0, None)],
)
def test_an_estimate_that_fits_no_wheel_and_not_the_camera_stops_the_robot(refused, nis, stops_in):
    """Equations that are refused at each read, by wheel: one wheel that fits is enough to go on."""
    supervisor, stopped = Supervised(SafetyLimits(stale_s={})), None
    for k in range(1, 40):
        read = WheelMeasurement(Stamp(k, k, k), np.zeros(4), np.zeros(4), np.zeros(4), (True,) * 4)
        supervisor.check(Inputs(k, k), Measurements(k, k, wheels=(read,)))
        figures = {f"rejected_wheel_{w.lower()}": float(k * n) for w, n in zip(WHEELS, refused, strict=True)}
        try:
            supervisor.guard(state(k, nis_mean_tracker=nis, **figures))
        except SafetyStop as stop:
            stopped = k, stop.reason
            break
    assert stopped == (stops_in and (stops_in, "sensors_disagree"))
