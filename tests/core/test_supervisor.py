"""What the supervisor does with what its checks find, and what a reset forgets."""

from dataclasses import replace

import numpy as np
import pytest
from supervised import Supervised

from hil.core.errors import SafetyStop
from hil.core.signals import (
    Inputs,
    Measurements,
    Reference,
    RobotState,
    ServoHealth,
    ServoSample,
    Stamp,
    Status,
    TrackerSample,
    WheelSetpoint,
)
from hil.loop.checks.cusum import Disagreement
from hil.loop.checks.sensor_rate import Healthy
from hil.loop.cycle_data import Check
from hil.loop.safety_limits import Checks, SafetyLimits

CYCLE_NS = 10_000_000
OK = (Status.OK,) * 8


class Asked(Check):
    """A watch that notes what it is asked, and says what it was given."""

    def __init__(self, *found):
        self.found, self.calls, self.left = found, [], []

    def reset(self):
        self.calls.append("reset")

    def update(self, measurements):
        self.calls.append("update")
        return self.found

    def leave_out(self, name):
        self.left.append(name)


def supervisor(limits=None, **checks):
    return Supervised(limits or SafetyLimits(stale_s={}), checks=Checks(**checks))


def cycle(supervisor, k=0, measured=True, **samples):
    t_ns = k * CYCLE_NS
    return supervisor.check(Inputs(k, t_ns, **samples), Measurements(k, t_ns) if measured else None)


def doubt(source, *, grave=True, confirmed=True, off=0.01):
    return Disagreement(source, "it differs", grave, confirmed, off)


def pose(t_ns):
    none = np.zeros(3)
    return TrackerSample(Stamp(t_ns, t_ns, 0), none, np.zeros(4), none, none, 3)


def servos(t_ns, angle_rad=0.0, status=OK):
    return ServoSample(
        Stamp(t_ns, t_ns, 0), np.full(8, angle_rad), np.zeros(8), np.zeros(8), status, (0,) * 8
    )


def test_a_doubt_is_reported_and_only_a_grave_one_stops_who_needs_the_camera():
    (event,) = cycle(supervisor(motion=Asked(doubt("tracker", grave=False)), needs_camera=True))
    assert (event.level, event.source, event.message) == ("warning", "tracker", "it differs")
    grave = Asked(doubt("tracker", confirmed=False))
    with pytest.raises(SafetyStop, match="it differs") as stop:
        cycle(supervisor(motion=grave, needs_camera=True, stops_by_steering=True))
    assert stop.value.reason == "sensors_disagree"
    assert cycle(supervisor(motion=grave)) == ()


def test_goals_that_were_clipped_are_an_event_with_servo_and_count():
    clipped = (0, 0, 0, 0, 0, 37, 0, 0)
    health = ServoHealth(Stamp(0, 0, 0), np.full(8, 12.0), np.full(8, 40.0), OK, clipped)
    (event,) = cycle(supervisor(), health=(health, replace(health, clipped=(0,) * 8)))
    assert (event.level, event.source) == ("warning", "servos")
    assert "steer_BL 37 times" in event.message


def test_who_is_left_out_is_so_until_the_reset_and_shakes_one_cycle_only():
    floor = SafetyLimits(stale_s={}, on_wall=False)
    motion = Asked(doubt("tracker"))
    watched = supervisor(floor, motion=motion, needs_camera=True, stops_by_steering=True)
    (event,) = cycle(watched)
    assert "left out" in event.message
    assert (motion.left, watched.inflation) == (["tracker"], (0.01, 0.0))
    motion.found = ()
    cycle(watched, 1)
    assert watched.inflation == (0.0, 0.0)
    assert "tracker" in watched.left_out
    watched.reset()
    assert "tracker" not in watched.left_out


def test_without_a_pose_to_follow_no_sensor_is_left_out():
    motion = Asked(doubt("tracker"))
    floor = SafetyLimits(stale_s={}, on_wall=False)
    with pytest.raises(SafetyStop):
        cycle(supervisor(floor, motion=motion, needs_camera=True))
    assert motion.left == []


def test_a_slide_names_what_holds_the_robot():
    fast = TrackerSample(Stamp(0, 0, 0), np.zeros(3), np.zeros(4), np.array([0.0, 0.6, 0.0]), np.zeros(3), 3)
    for holders, end in (
        ({"adhesion": "fan", "thrust": "propellers"}, "no hold; look at the fan and the propellers"),
        ({}, "no hold"),
    ):
        with pytest.raises(SafetyStop) as stop:
            cycle(supervisor(holders=holders), tracker=(fast,) * 3)
        assert stop.value.reason == "sliding"
        assert set(stop.value.suspects) == {"tracker", *holders}
        assert str(stop.value).endswith(end)


def blind(watched, since, until):
    """Cycles without a pose, after one with it; the last events."""
    cycle(watched, since, tracker=(pose(since * CYCLE_NS),))
    events = ()
    for k in range(since + 1, until):
        events += cycle(watched, k)
    return events


def test_a_blind_camera_stops_only_who_needs_it_and_a_reset_forgets_its_silence():
    limits = SafetyLimits(stale_s={"tracker": 0.5})
    assert "stale" in blind(supervisor(limits), 0, 60)[-1].message
    needing = supervisor(limits, needs_camera=True)
    with pytest.raises(SafetyStop, match=r"no usable pose of the camera for 0\.5 s"):
        blind(needing, 0, 60)
    needing.reset()
    assert cycle(needing, 100) == ()


def test_a_camera_that_was_left_out_may_be_blind():
    floor = SafetyLimits(stale_s={"tracker": 0.5}, on_wall=False)
    motion = Asked(doubt("tracker"))
    watched = supervisor(floor, motion=motion, needs_camera=True, stops_by_steering=True)
    cycle(watched)
    motion.found = ()
    blind(watched, 1, 100)


def test_a_sensor_that_sends_too_little_is_reported_anew_after_a_reset():
    watched = supervisor(healthy={"tracker": Healthy(100.0, 0.95, 0.07, 100.0)})
    for _ in range(2):
        events = ()
        for k in range(400):
            t_ns = k * CYCLE_NS
            events += cycle(watched, k, tracker=(pose(t_ns),) if k < 150 or k % 2 else ())
        assert ["good samples a second" in e.message for e in events] == [True]
        watched.reset()


def test_servos_that_stand_are_named_where_sensors_disagree():
    motion = Asked()
    watched = supervisor(motion=motion, needs_camera=True)
    asked = WheelSetpoint(np.array([2.0, 0, 0, 0]), np.zeros(4))
    for k in range(20):
        watched.limit(asked)
        cycle(watched, k, servos=(servos(k * CYCLE_NS),))
    motion.found = (doubt("tracker", confirmed=False),)
    with pytest.raises(SafetyStop, match=r"wheel FL is asked for 2\.00 rad/s") as stop:
        cycle(watched, 20, servos=(servos(20 * CYCLE_NS),))
    assert stop.value.reason == "blocked"
    assert "also sensors_disagree: it differs" in str(stop.value)


class Silent(Asked):
    """What measures the force, unheard for 0.25 s where cycles are further apart."""

    def reset(self):
        self.last_ns = 0

    def on_samples(self, cycle):
        last_ns, self.last_ns = self.last_ns, cycle.inputs.t_ns
        if self.last_ns - last_ns > 250_000_000:
            cycle.stop("stale_adhesion", "nothing usable: check its bus")


def test_a_loop_that_stood_still_stops_the_robot_and_not_its_devices():
    watching = supervisor(hold=Silent())
    cycle(watching, 0)
    cycle(watching, 25)
    with pytest.raises(SafetyStop, match=r"stood still for 0\.5 s") as stopped:
        cycle(watching, 76)
    assert stopped.value.reason == "held_up"
    assert "stale" not in str(stopped.value), "nothing asked the devices meanwhile"
    cycle(watching, 77)
    watching.reset()
    cycle(watching, 20)
    with pytest.raises(SafetyStop) as silent:
        cycle(watching, 50)
    assert silent.value.reason == "stale_adhesion"


@pytest.mark.parametrize(
    ("each", "paused", "waited", "reported"),
    [(1, 12, 5, True), (1, 12, 120, False), (1, 4, 5, False), (5, 12, 5, False), (3, 12, 5, True)],
)
def test_a_stop_soon_after_a_pause_says_so(each, paused, waited, reported):
    """Watchdogs have tripped and buffers run over meanwhile: devices that are well look broken."""
    motion = Asked()
    watching = supervisor(motion=motion, needs_camera=True)
    began, ended = 900, 900 + 2 * each + paused
    for k in (began, began + each, began + 2 * each, ended, *(ended + n * each for n in range(1, waited))):
        cycle(watching, k)
    motion.found = (doubt("tracker", confirmed=False),)
    with pytest.raises(SafetyStop) as stop:
        cycle(watching, ended + waited * each)
    assert stop.value.reason == "sensors_disagree"
    assert ("the control loop had stood still for 0.12 s just before" in str(stop.value)) == reported


def test_after_a_reset_nothing_of_the_last_run_counts():
    """Servos that were heard long ago, and a camera that was found not to fit."""
    watching = supervisor(SafetyLimits(stale_s={"servos": 0.1}, on_wall=False))
    cycle(watching, 0, servos=(servos(0),))
    misfit = RobotState(0, np.zeros(3), np.zeros(3), np.eye(6), {"nis_mean_tracker": 50.0})
    assert watching.guard(misfit, None)
    watching.reset()
    cycle(watching, 400)
    assert watching.inflation == (0.0, 0.0)
    assert watching.guard(replace(misfit, t_ns=400 * CYCLE_NS), None), "it is reported anew"


@pytest.mark.parametrize("place", [(0.9, 0.0), (0.0, 0.9), (-0.9, -0.9)])
def test_how_far_it_is_from_the_reference_counts_and_not_where(place):
    pose = np.array([*place, 0.0])
    state = RobotState(0, pose, np.zeros(3), np.eye(6))
    watching = supervisor(SafetyLimits(stale_s={}, on_wall=False, tracking_error_limit_m=0.5))
    watching.guard(state, Reference(0.0, pose, np.zeros(3), np.zeros(2)))
    for way in ([0.6, 0.0, 0.0], [0.0, -0.6, 0.0]):
        with pytest.raises(SafetyStop, match=r"0\.600 m from the reference"):
            watching.guard(state, Reference(0.0, pose + way, np.zeros(3), np.zeros(2)))


@pytest.mark.parametrize(("place", "value"), [(0, np.nan), (2, np.inf)])
def test_what_is_not_finite_is_refused_wherever_it_stands(place, value):
    values = np.zeros(3)
    values[place] = value
    good = RobotState(0, np.zeros(3), np.zeros(3), np.eye(6))
    for state, reference in (
        (RobotState(0, values, np.zeros(3), np.eye(6)), None),
        (RobotState(0, np.zeros(3), values, np.eye(6)), None),
        (good, Reference(0.0, values, np.zeros(3), np.zeros(2))),
    ):
        with pytest.raises(SafetyStop) as stop:
            supervisor().guard(state, reference)
        assert stop.value.reason == "not_finite"
    wheels = np.array([*values, 0.0])
    for setpoint in (WheelSetpoint(wheels, np.zeros(4)), WheelSetpoint(np.zeros(4), wheels)):
        with pytest.raises(SafetyStop) as stop:
            supervisor().limit(setpoint)
        assert stop.value.reason == "not_finite"


@pytest.mark.parametrize("angle_rad", [2.1, -2.1])
def test_a_steering_angle_beyond_the_limit_is_refused_on_both_sides(angle_rad):
    limited = supervisor(SafetyLimits(steering_limit_rad=2.0))
    with pytest.raises(SafetyStop) as stop:
        limited.limit(WheelSetpoint(np.zeros(4), np.array([0.0, 0.0, angle_rad, 0.0])))
    assert stop.value.reason == "steering_limit"
    assert "safety.steering_limit_rad" in str(stop.value)
    assert "alignment.steer_zero_rad" in str(stop.value)
    limited.limit(WheelSetpoint(np.zeros(4), np.full(4, 2.0)))


class Unsure(Asked):
    """A watch that makes the estimate unsure, and can be informed that wheels slip."""

    def __init__(self, off_m, off_rad):
        super().__init__()
        self.off = off_m, off_rad

    def on_estimate(self, cycle):
        cycle.inflate_next(self.off)

    def doubt(self):
        self.calls.append("doubt")


def test_the_estimate_is_as_unsure_as_the_watch_says_that_doubts_it_most():
    watched = supervisor(estimate=Unsure(0.003, 0.0), wheels=Unsure(0.001, 0.2))
    watched.guard(RobotState(0, np.zeros(3), np.zeros(3), np.eye(6)))
    cycle(watched)
    assert watched.inflation == (0.003, 0.2)


@pytest.mark.parametrize(("source", "reported"), [("servos", True), ("tracker", False)])
def test_who_watches_the_wheels_hears_from_others_that_they_may_slip(source, reported):
    wheels = Unsure(0.0, 0.0)
    cycle(supervisor(motion=Asked(doubt(source, grave=False)), wheels=wheels))
    assert ("doubt" in wheels.calls) is reported
