"""The wheel that rolls otherwise than the other three say is named, with its servo and ID."""

import re

import numpy as np
import pytest

from hil.core.signals import Stamp, WheelMeasurement
from hil.loop.checks.wheel_slip import WheelSlipCheck
from hil.robot.kinematics import WheelGeometry, inverse
from tests.selected import every

GEOMETRY = WheelGeometry.nominal()
PERIOD_NS = 30_000_000
IDS = (11, 12, 13, 14, 21, 22, 23, 24)
TWISTS = {
    "up": (0.05, 0.0, 0.0),
    "across": (0.0, 0.05, 0.0),
    "turn": (0.0, 0.0, 0.3),
    "arc": (0.05, 0.02, 0.2),
}
COUNT_RAD = 2 * np.pi / 4096


class Ride:
    """Wheels that roll by one twist, as their encoders count it; `shares` (4,) of it from `at` s on."""

    def __init__(self, twist, ids=IDS):
        self.watch, self.events, self.off_m = WheelSlipCheck(GEOMETRY, ids), [], []
        speed, self.steering = inverse(GEOMETRY, np.array(twist))
        self.rate = speed / GEOMETRY.radius_m
        self.angle, self.k = np.zeros(4), 0

    def go(self, seconds, shares=(1.0,) * 4, valid=(True,) * 4):
        for _ in range(round(seconds * 1e9 / PERIOD_NS)):
            self.k += 1
            self.angle = self.angle + self.rate * np.array(shares) * PERIOD_NS * 1e-9
            reported, t_ns = np.round(self.angle / COUNT_RAD) * COUNT_RAD, self.k * PERIOD_NS
            sample = WheelMeasurement(Stamp(t_ns, t_ns, self.k), reported, self.rate, self.steering, valid)
            self.watch.judge(t_ns, (sample,), self.events)
            self.off_m.append(self.watch.take_inflation()[0])
        return self


@pytest.mark.parametrize("twist", list(TWISTS.values()), ids=list(TWISTS))
def test_wheels_that_roll_by_one_motion_are_let_be(twist):
    ride = Ride(twist).go(10.0)
    assert ride.events == []
    assert not any(ride.off_m)


@pytest.mark.parametrize(
    ("twist", "wheel", "share"),
    every(5, [(t, w, s) for t in TWISTS.values() for w in range(4) for s in (0.3, 0.7, 1.3)]),
)
def test_the_wheel_that_rolls_otherwise_is_named_soon_and_once(twist, wheel, share):
    ride = Ride(twist).go(2.0)
    shares = [1.0] * 4
    shares[wheel] = share
    ride.go(1.0, shares)
    (event,) = ride.events
    name = ("FL", "BL", "BR", "FR")[wheel]
    assert event.source == "servos"
    assert f"wheel {name} (drive_{name}, ID {IDS[wheel]})" in event.message
    assert 2.0 < event.t_ns * 1e-9 < 2.5


def test_without_known_ids_the_servo_is_named():
    ride = Ride(TWISTS["up"], ids=()).go(1.0).go(0.5, (1.0, 1.0, 0.5, 1.0))
    assert "wheel BR (drive_BR) rolled" in ride.events[0].message


def test_what_the_message_says_is_what_the_wheels_have_rolled():
    ride = Ride(TWISTS["up"]).go(1.0)
    ride.go(0.18, (2.0, 1.0, 1.0, 1.0))
    said = re.search(
        r"rolled (.*) mm in 0.4 s and the other three say (.*) mm \((.*) %\)", ride.events[0].message
    )
    rolled_mm, others_mm, percent = map(float, said.groups())
    assert others_mm == pytest.approx(0.4 * 50.0, abs=4.0), "0.05 m/s, in whole steps"
    assert 4.0 < rolled_mm - others_mm < 9.0, "0.05 m/s more for as long as it took to be sure"
    assert percent == pytest.approx(100.0 * rolled_mm / others_mm, abs=1.0)


def test_the_estimate_is_unsure_by_more_the_farther_it_goes():
    ride = Ride(TWISTS["up"]).go(1.0).go(0.3, (2.0, 1.0, 1.0, 1.0))
    assert np.sqrt(np.sum(np.square(ride.off_m))) == pytest.approx(0.003, abs=1e-9)
    ride.go(10.0)
    sigma_m = np.sqrt(np.sum(np.square(ride.off_m)))
    assert sigma_m == pytest.approx(0.003 + 0.05 * 0.51, abs=0.003)


def test_who_hears_from_others_that_wheels_slip_has_the_whole_way_unsure():
    ride = Ride(TWISTS["up"]).go(4.0)
    ride.watch.doubt()
    ride.go(0.1)
    assert np.sqrt(np.sum(np.square(ride.off_m))) == pytest.approx(0.003 + 0.05 * 0.2, abs=0.0005)
    assert ride.events == []


def test_wheels_whose_directions_come_late_while_they_are_steered_are_let_be():
    """The reported direction is one sample behind."""
    ride = Ride(TWISTS["up"]).go(1.0)
    for k in range(40):
        turned = inverse(GEOMETRY, np.array([0.05, 0.0, 0.01 * k]))
        ride.rate = inverse(GEOMETRY, np.array([0.05, 0.0, 0.01 * (k + 1)]))[0] / GEOMETRY.radius_m
        ride.steering = turned[1]
        ride.go(0.03)
    assert ride.events == []


def test_one_wrong_count_is_no_slip():
    ride = Ride(TWISTS["up"]).go(1.0)
    ride.angle[2] += 2.0 * COUNT_RAD
    ride.go(2.0)
    assert ride.events == []


def test_incomplete_reads_are_bridged_and_a_leap_of_an_encoder_begins_anew():
    ride = Ride(TWISTS["up"]).go(1.0).go(0.2, valid=(True, False, True, True)).go(1.0)
    ride.angle[1] += 1.0
    ride.go(1.0)
    assert ride.events == []


def test_a_reset_forgets_who_slipped():
    ride = Ride(TWISTS["up"]).go(1.0).go(0.5, (0.5, 1.0, 1.0, 1.0))
    ride.watch.reset()
    ride.events.clear()
    ride.off_m.clear()
    ride.go(2.0)
    assert ride.events == []
    assert not any(ride.off_m)
    ride.go(0.5, (0.5, 1.0, 1.0, 1.0))
    assert len(ride.events) == 1


def rolled(watch, angles, first=0, period_ns=100_000_000, valid=True):
    """Reports on wheels that stand straight and measure these angles (4,), one after the other."""
    events = []
    for k, angle in enumerate(angles, first):
        stamp = Stamp(k * period_ns, k * period_ns, k)
        sample = WheelMeasurement(stamp, np.array(angle), np.zeros(4), np.zeros(4), (True, True, valid, True))
        watch.judge(k * period_ns, (sample,), events)
    return events


@pytest.mark.parametrize(("alone_m", "reported"), [(0.0005, False), (0.0012, True), (-0.0012, True)])
def test_a_wheel_that_rolls_alone_by_a_millimetre_is_named(alone_m, reported):
    alone = [0.0, 0.0, alone_m / GEOMETRY.radius_m[2], 0.0]
    events = rolled(WheelSlipCheck(GEOMETRY), [[0.0] * 4, alone, alone, alone])
    assert bool(events) is reported


def test_what_an_incomplete_read_says_of_its_wheel_does_not_count():
    watch = WheelSlipCheck(GEOMETRY)
    ahead = [[0.05 * k] * 4 for k in range(10)]
    events = rolled(watch, ahead[:5])
    for k in range(5, 8):
        events += rolled(watch, [[ahead[k][0], ahead[k][1], 0.0, ahead[k][3]]], k, valid=False)
    assert events + rolled(watch, ahead[8:], 8) == []


def test_what_was_seen_before_a_leap_of_an_encoder_does_not_count_behind_it():
    """A wheel seen once to roll otherwise is named when it is seen again; a leap begins anew."""
    apart = [0.0, 0.0, 0.1, 0.0]
    assert rolled(WheelSlipCheck(GEOMETRY), [[0.0] * 4, apart, apart])
    assert rolled(WheelSlipCheck(GEOMETRY), [[0.0] * 4, apart, [0.0, 0.0, 2.1, 0.0]]) == []
