"""The estimate against motion capture over a whole run: reported, widened, stopped, and whose fault it is."""

import re

import numpy as np
import pytest
from supervised import Supervised

from hil.core.errors import SafetyStop
from hil.core.signals import Inputs, Measurements, PoseMeasurement, RobotState, Stamp, WheelMeasurement
from hil.loop.checks.mocap_agreement import MocapTolerances
from hil.loop.checks.mocap_estimate import MocapEstimate
from hil.loop.checks.motion_agreement import MotionCheck
from hil.loop.safety_limits import Checks, SafetyLimits
from hil.robot.kinematics import WheelGeometry, inverse

GEOMETRY = WheelGeometry.nominal()
PERIOD_NS = 10_000_000
SPEED_M_S = 0.1
UP, ACROSS = np.array([SPEED_M_S, 0.0]), np.array([0.0, SPEED_M_S])


def turned(way, angle_rad):
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([c * way[0] - s * way[1], s * way[0] + c * way[1]])


class Run:
    """Straight ahead at these speeds (2,), m/s; sigma of the estimate in m along both axes."""

    def __init__(
        self,
        true,
        *,
        estimate=None,
        camera=None,
        wheels=None,
        sigma_m=0.0005,
        sigma_rad=1e-4,
        axes_rad=0.0,
        follows=True,
    ):
        self.true = true
        self.estimate, self.camera, self.wheels = (
            true if speed is None else np.asarray(speed) for speed in (estimate, camera, wheels)
        )
        self.sigma_m, self.sigma_rad, self.axes_rad = sigma_m, sigma_rad, axes_rad
        motion = MotionCheck(GEOMETRY)
        self.watch = MocapEstimate(motion.capture, follows=follows)
        self.supervisor = Supervised(
            SafetyLimits(stale_s={}), checks=Checks(motion=motion, estimate=self.watch, needs_camera=follows)
        )
        self.events, self.off_m = [], []

    def pose(self, name, speed, t_ns, now_ns, angle_rad=0.0, valid=True):
        place = turned(speed * t_ns * 1e-9, angle_rad)
        return PoseMeasurement(Stamp(t_ns, now_ns, 0), name, np.array([*place, angle_rad]), 3, valid)

    def measured(self, k, valid=True):
        t_ns = k * PERIOD_NS
        _, steering = inverse(GEOMETRY, np.array([*self.wheels, 0.0]))
        angle = np.hypot(*self.wheels) * t_ns * 1e-9 / GEOMETRY.radius_m
        return Measurements(
            k,
            t_ns,
            wheels=(WheelMeasurement(Stamp(t_ns, t_ns, k), angle, angle, steering, (True,) * 4),),
            tracker=(self.pose("tracker", self.camera, t_ns - 25_000_000, t_ns),),
            mocap=(self.pose("mocap", self.true, t_ns - 5_000_000, t_ns, self.axes_rad, valid),),
        )

    def cycle(self, k, **changed):
        self.events += self.supervisor.check(Inputs(k, k * PERIOD_NS), self.measured(k, **changed))
        self.off_m.append(self.supervisor.inflation[0])
        self.sigma_m = np.hypot(self.sigma_m, self.off_m[-1])
        covariance = np.diag([self.sigma_m**2] * 2 + [self.sigma_rad**2] + [1e-8] * 3)
        pose = np.array([*self.estimate * k * PERIOD_NS * 1e-9, 0.0])
        self.events += self.supervisor.guard(RobotState(k * PERIOD_NS, pose, np.zeros(3), covariance), None)

    def go(self, cycles, first=3, **changed):
        for k in range(first, cycles):
            self.cycle(k, **changed)
        return self

    @property
    def reported(self):
        return [e for e in self.events if "the estimate has gone" in e.message]


@pytest.mark.parametrize(("way", "axes_rad"), [(UP, 0.0), (ACROSS, 0.7), (-UP, -2.0)])
def test_an_estimate_that_is_right_is_let_be_however_the_axes_of_the_room_lie(way, axes_rad):
    run = Run(way, axes_rad=axes_rad).go(800)
    assert run.events == []
    assert not any(run.off_m)


def test_what_the_estimate_itself_takes_for_possible_is_not_reported():
    assert Run(UP, estimate=0.97 * UP, sigma_m=0.01).go(800).reported == []


@pytest.mark.parametrize(("way", "share"), [(UP, 0.96), (ACROSS, 1.04)])
def test_a_slow_lie_of_the_camera_is_reported_once_widens_the_estimate_and_stops(way, share):
    run = Run(way, estimate=share * way, camera=share * way)
    with pytest.raises(SafetyStop, match="the camera may be wrong") as stopped:
        run.go(1500)
    (event,) = run.reported
    assert event.source == "tracker"
    gone_m, true_m = map(float, re.findall(r"(\d\.\d{3}) m", event.message)[:2])
    assert gone_m == pytest.approx(share * true_m, abs=0.001)
    assert 0.004 < abs(gone_m - true_m) < 0.009
    off_m = 0.04 * len(run.off_m) * PERIOD_NS * 1e-9 * SPEED_M_S
    assert 0.018 < off_m < 0.026
    assert 3.0 * run.sigma_m + 0.005 > off_m
    assert stopped.value.reason == "sensors_disagree"


def test_wheels_that_slip_a_little_all_together_are_the_ones_that_are_named():
    run = Run(ACROSS, estimate=1.05 * ACROSS, wheels=1.05 * ACROSS)
    with pytest.raises(SafetyStop, match="the wheels may be wrong"):
        run.go(1500)
    assert {e.source for e in run.reported} == {"servos"}


def test_motion_capture_that_camera_and_wheels_contradict_stops_no_robot():
    """Its scale is off by as much as the sums allow; the estimate is unsure all the same."""
    run = Run(0.97 * ACROSS, estimate=ACROSS, camera=ACROSS, wheels=ACROSS).go(1500)
    assert {e.source for e in run.reported} == {"mocap"}
    assert "agree against motion capture" in run.reported[0].message
    assert 3.0 * run.sigma_m + 0.005 > 0.03 * 1.5


def test_without_following_the_estimate_there_is_only_a_warning():
    run = Run(UP, estimate=0.95 * UP, camera=0.95 * UP, follows=False).go(1000)
    assert run.reported
    assert 3.0 * run.sigma_m + 0.005 > 0.05 * 1.0


def test_a_drift_aside_within_what_the_rigid_bodys_axes_may_be_turned_by_is_reported_and_stops_no_robot():
    aside = np.array([0.0, 0.04 * SPEED_M_S])
    run = Run(UP, estimate=UP + aside, camera=UP + aside).go(1000)
    assert "aside" in run.reported[0].message
    assert "align them" in run.reported[0].message
    assert 3.0 * run.sigma_m + 0.005 > 0.04 * 1.0


def test_a_drift_aside_that_no_axes_explain_stops():
    aside = np.array([0.0, 0.03])
    run = Run(0.2 * UP, estimate=0.2 * UP + aside, camera=0.2 * UP)
    with pytest.raises(SafetyStop, match="sensors_disagree"):
        run.go(400)


def test_behind_a_gap_what_was_found_before_still_counts():
    run = Run(UP, estimate=0.96 * UP, camera=0.96 * UP).go(300)
    first = len(run.reported)
    run.go(340, first=300, valid=False)
    with pytest.raises(SafetyStop, match="sensors_disagree"):
        run.go(1500, first=340)
    assert first == 1
    assert 0.018 < 0.04 * SPEED_M_S * (len(run.off_m) - 40) * PERIOD_NS * 1e-9 < 0.028


def test_nothing_is_judged_by_a_motion_capture_that_was_left_out():
    run = Run(UP, estimate=0.9 * UP, camera=0.96 * UP)
    run.supervisor.left_out._names.add("mocap")
    assert run.go(600).reported == []


def test_a_reset_begins_a_new_run():
    run = Run(UP, estimate=0.96 * UP, camera=0.96 * UP).go(300)
    run.supervisor.reset()
    run.events.clear()
    run.sigma_m = 0.0005
    assert run.go(390, first=301).reported == []
    assert run.go(520, first=390).reported


def test_a_turned_rigid_body_may_be_off_by_its_lever():
    """Motion capture sees a point beside the robot's origin: it goes round while the robot turns in place."""
    motion, rate = MotionCheck(GEOMETRY), 0.5
    watch, events = MocapEstimate(motion.capture, follows=True), []
    for k in range(1, 600):
        t_ns, heading = k * PERIOD_NS, rate * k * PERIOD_NS * 1e-9
        lever = MocapTolerances().lever_m * 0.9
        place = np.array([lever * np.cos(heading) - lever, lever * np.sin(heading), heading])
        motion.capture.take((), (PoseMeasurement(Stamp(t_ns, t_ns, k), "mocap", place, 3, True),))
        covariance = np.diag([1e-8] * 6)
        watch.judge(RobotState(t_ns, np.array([0.0, 0.0, heading]), np.zeros(3), covariance), events, print)
    assert events == []


@pytest.mark.parametrize(
    ("way", "sigma_rad", "reported"),
    [(UP, 0.015, False), (-ACROSS, 0.015, False), (ACROSS, 1e-4, True), (-UP, 1e-4, True)],
)
def test_who_was_unsure_of_its_heading_at_the_start_may_go_aside(way, sigma_rad, reported):
    aside = turned(way, 0.035)
    run = Run(way, estimate=aside, camera=aside, sigma_rad=sigma_rad).go(600)
    assert bool(run.reported) is reported


def test_a_lie_is_found_as_late_in_every_direction():
    stopped = set()
    for way in (UP, -UP):
        run = Run(way, estimate=0.96 * way, camera=0.96 * way, sigma_m=0.001)
        with pytest.raises(SafetyStop, match="the camera may be wrong"):
            run.go(1500)
        stopped.add(len(run.off_m))
    assert len(stopped) == 1


def test_what_is_reported_makes_the_estimate_unsure_of_all_that_may_come_until_it_stops():
    run = Run(UP, estimate=0.96 * UP, camera=0.96 * UP, sigma_m=1e-5)
    while not run.reported:
        run.go(len(run.off_m) + 4, len(run.off_m) + 3)
    at_k = len(run.off_m) + 3
    run.go(at_k + 1, at_k)
    assert 3.0 * run.off_m[-1] > 0.006 + 0.0145
