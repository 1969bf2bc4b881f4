"""An estimate that does not say how sure it is, or of when it is, stops the robot: nothing could judge it."""

import math

import numpy as np
import pytest
from supervised import Supervised

import hil
from hil.core.errors import SafetyStop
from hil.core.signals import Inputs, RobotState
from hil.loop.safety_limits import SafetyLimits
from hil.robot.trajectories import line

CYCLE_NS = 10_000_000
WAY = line((0, 0, 0), (0.25, 0, 0), duration_s=6.0)


def judged(covariance=None, *, of_cycle=0, now_cycle=None, pose=(0.0, 0.0, 0.0), twist=(0.0, 0.0, 0.0)):
    """The stop of a supervisor that has judged the cycle `now_cycle`; None where the estimate passes."""
    supervisor = Supervised(SafetyLimits(stale_s={}))
    if now_cycle is not None:
        supervisor.check(Inputs(now_cycle, now_cycle * CYCLE_NS))
    covariance = np.eye(6) if covariance is None else covariance
    try:
        supervisor.guard(RobotState(of_cycle * CYCLE_NS, np.array(pose), np.array(twist), covariance), None)
    except SafetyStop as stop:
        return stop
    return None


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("what", ["pose", "twist"])
def test_one_number_that_is_none_makes_the_whole_estimate_useless(what, place, value):
    values = np.zeros(3)
    values[place] = value
    assert judged(**{what: values}).reason == "not_finite"


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(("place", "name"), [(0, "x"), (1, "y"), (2, "heading"), (5, "turn rate")])
def test_a_variance_that_is_no_number_is_named(place, name, value):
    covariance = np.eye(6)
    covariance[place, place] = value
    stop = judged(covariance)
    assert stop.reason == "not_finite"
    assert f"its variance of {name} is not finite" in str(stop)


def test_a_negative_variance_is_named_and_rounding_is_none():
    stop = judged(np.diag([1.0, -1e-6, 1.0, 1.0, 1.0, 1.0]))
    assert stop.reason == "negative_variance"
    assert "variance of y is negative, expected 0 or more" in str(stop)
    assert judged(np.diag([0.0, -1e-15, 0.0, 0.0, 0.0, 0.0])) is None


@pytest.mark.parametrize(("of", "now", "reported"), [(0, 11, "0.110 s behind"), (40, 20, "0.200 s ahead of")])
def test_an_estimate_of_another_time_is_named(of, now, reported):
    stop = judged(of_cycle=of, now_cycle=now)
    assert stop.reason == "stale_estimate"
    assert f"the estimate's time is {reported} that of the cycle, expected at most 0.1 s" in str(stop)


def test_an_estimate_may_be_a_little_old_and_is_not_asked_before_the_first_cycle():
    assert judged(of_cycle=0, now_cycle=10) is None
    assert judged(of_cycle=500) is None


class Stuck:
    """An estimator that says that the robot has never moved."""

    def __init__(self, covariance, *, in_time):
        self._covariance, self._in_time = covariance, in_time

    def reset(self, state):
        pass

    def update(self, measurements):
        t_ns = measurements.t_ns if self._in_time else 0
        return RobotState(t_ns, np.zeros(3), np.zeros(3), self._covariance)


@pytest.mark.parametrize(
    ("estimator", "reason"),
    [
        (Stuck(np.full((6, 6), math.nan), in_time=True), "not_finite"),
        (Stuck(1e-6 * np.eye(6), in_time=False), "stale_estimate"),
    ],
    ids=["no covariance", "time stands still"],
)
def test_an_estimator_that_says_it_never_moved_does_not_get_far(monkeypatch, estimator, reason):
    """Motion capture contradicts it; that was not noticed, and the robot went four times as far as asked."""
    with hil.open_bench("emulated", seed=1) as bench:
        make_pipeline = bench.make_pipeline

        def pipeline(*given, **how):
            made = make_pipeline(*given, **how)
            made.estimator = estimator
            return made

        monkeypatch.setattr(bench, "make_pipeline", pipeline)
        with pytest.raises(SafetyStop) as stop:
            bench.drive(WAY, start_pose=np.zeros(3))
        assert stop.value.reason == reason
        assert abs(bench.truth().pose_body_in_wall[0]) < 0.005
        bench.devices.actuators().close()
