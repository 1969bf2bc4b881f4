"""What presses a robot on its wall by what fan, cells and propellers tell: believed while it can be true."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hil.bench.hold.adhesion_force import RUN_DOWN_S, AdhesionForceCheck, press_watch
from hil.bench.hold.propeller_handover import PropellerObservation, least_push_n
from hil.bench.loop_settings import adhesion_limits
from hil.config.loading import load_bench
from hil.config.thrust import TeensyConfig, ThrustConfig
from hil.core.errors import DeviceError
from hil.core.signals import AdhesionSample, LoadCellSample, Stamp, Status, ThrustSample
from hil.robot.believed_force import UNCONFIRMED

KNOWN = adhesion_limits(load_bench("emulated"))
FAN = replace(KNOWN.fan, highest_n=1000.0, rpm_per_v=math.nan)
LIMITS = replace(KNOWN, nominal_thrust_n=0.0, zero_n=0.0, fan=FAN)
NEED_N = LIMITS.statics.needed_n(0.0, 0.0)
STALE_S, TIMEOUT_S, STEP_S = LIMITS.stale_s, 0.5, 0.02
ALONE_N = UNCONFIRMED * NEED_N
"""What one sensor alone must measure."""
TEENSY = TeensyConfig()
WITHOUT = replace(LIMITS, nominal_thrust_n=20.0)
REPORTS = replace(WITHOUT, reports_thrust=True, full_thrust_n=20.0)


class Press:
    """A watch with devices that deliver what is put there, and a clock of its own."""

    def __init__(self, limits=LIMITS, propellers=TEENSY):
        self.waiting, self.t_s = {"adhesion": [], "load_cells": [], "thrust": []}, 100.0
        self.alone = []
        rig = SimpleNamespace(get=self._device)
        alone = PropellerObservation(rig, propellers, limits.nominal_thrust_n)
        self.watch = AdhesionForceCheck(rig, limits, SimpleNamespace(timeout_s=TIMEOUT_S), alone)
        self.watch.begin(for_good=True)

    def _ns(self):
        return round(self.t_s * 1e9)

    def _device(self, name):
        return SimpleNamespace(read=lambda: self._read(name), leave_alone=self.alone.append)

    def _read(self, name):
        taken, self.waiting[name] = self.waiting[name], []
        if taken is None:
            raise DeviceError(name, "does not answer")
        return taken

    def doubt(self, *, fan=None, cells=None, push=None, sees_slide=True, moves=False, after_s=STEP_S):
        """What is doubted some time after the last time, when these forces, N, have just been measured."""
        self.t_s += after_s
        stamp = Stamp(self._ns(), self._ns(), 0)
        if fan is not None:
            speed_rpm = FAN.rated_rpm * (fan / FAN.rated_n) ** 0.5
            self.waiting["adhesion"] = [AdhesionSample(stamp, speed_rpm, *[math.nan] * 6)]
        if cells is not None:
            halves = np.array([0.5 * cells] * 2)
            self.waiting["load_cells"] = [LoadCellSample(stamp, halves, (Status.OK, Status.OK), (0, 0))]
        if push is not None:
            throttle = (push / REPORTS.full_thrust_n) ** 0.5
            self.waiting["thrust"] = [ThrustSample(stamp, throttle, math.nan)]
        return self.watch.doubt(self._ns(), sees_slide=sees_slide, moves=moves)

    def words(self):
        return self.watch.in_words(self._ns())


def test_enough_is_what_the_robot_needs_by_everybody_who_measures():
    press = Press()
    assert "no sensor measures it" in press.doubt()
    assert f"{ALONE_N:.1f} N are needed (1.5 times" in press.doubt(fan=0.98 * ALONE_N)
    assert press.doubt(fan=1.02 * ALONE_N) == ""
    assert press.watch.basis(press._ns())[:2] == ("fan's speed", False)
    assert press.doubt(fan=1.02 * NEED_N, cells=1.02 * NEED_N), (
        "no fan changes its speed so within one report"
    )
    assert press.doubt(fan=1.02 * NEED_N, cells=1.02 * NEED_N) == ""
    assert press.watch.basis(press._ns())[1] is True
    assert f"{NEED_N:.1f} N are needed" in press.doubt(fan=1.02 * NEED_N, cells=0.98 * NEED_N)
    assert "are needed" in press.doubt(fan=0.98 * NEED_N, cells=1.02 * NEED_N)


def test_what_was_heard_a_while_ago_is_no_force():
    press = Press()
    assert press.doubt(fan=2.0 * NEED_N) == ""
    assert press.doubt(after_s=0.9 * STALE_S) == ""
    assert "no sensor measures it" in press.doubt(after_s=0.2 * STALE_S)
    assert press.words().endswith(
        "pressed on the wall: nothing by the fan's speed, nothing by the load cells"
    )


def test_a_look_right_after_another_one_begins_anew():
    press = Press()
    assert press.doubt(fan=2.0 * NEED_N) == ""
    press.watch.begin()
    assert "no sensor measures it" in press.doubt(after_s=0.0)


def test_a_fan_that_fails_to_answer_is_silent_and_ends_nothing():
    press = Press()
    press.waiting["adhesion"] = press.waiting["load_cells"] = None
    assert "no sensor measures it" in press.doubt()


def steady(press, seconds, **forces):
    """What is doubted at each step of a while in which the same is measured."""
    return [press.doubt(**forces) for _ in range(round(seconds / STEP_S))]


def test_with_a_silent_fan_the_cells_must_feel_enough_for_longer_than_it_takes_to_run_down():
    press, lasts_s = Press(), RUN_DOWN_S + TIMEOUT_S
    early = steady(press, lasts_s - 0.1, cells=2.0 * NEED_N)
    assert all("the fan's controller is silent" in doubt for doubt in early)
    assert "are needed" in press.doubt(cells=0.9 * ALONE_N)
    again = steady(press, lasts_s + 0.2, cells=2.0 * NEED_N)
    assert all(
        "the fan's controller is silent" in doubt for doubt in again[: round((lasts_s - 0.1) / STEP_S)]
    )
    assert again[-5:] == [""] * 5
    assert press.watch.feels(press._ns())


@pytest.mark.parametrize(("falls_n_s", "doubted"), [(0.03 * NEED_N, False), (1.2 * NEED_N, True)])
def test_a_force_that_will_not_be_enough_once_the_fan_has_run_down_is_doubted_before(falls_n_s, doubted):
    press, force_n, doubts = Press(), 2.0 * NEED_N, []
    for _ in range(20):
        doubts.append(press.doubt(fan=force_n))
        force_n -= falls_n_s * STEP_S
    assert force_n > ALONE_N
    assert any("the force by the fan's speed falls by" in doubt for doubt in doubts) is doubted


ENOUGH_N = 1.02 * UNCONFIRMED * WITHOUT.statics.needed_n(20.0, 0.0)
"""With the propellers, and not without."""


def force_lost_after_s():
    """So long it takes propellers whose throttle goes down by 10 steps a second until the robot slides."""
    least_n = WITHOUT.nominal_thrust_n
    while WITHOUT.statics.needed_n(least_n, 0.0) < ENOUGH_N:
        least_n -= 0.1
    return 18.0 * ((20.0 / TEENSY.full_force_n) ** 0.5 - (least_n / TEENSY.full_force_n) ** 0.5)


def test_propellers_that_report_nothing_count_once_deaf_ones_would_have_let_the_robot_slide():
    press, slides_s = Press(WITHOUT), force_lost_after_s()
    early = steady(press, slides_s, fan=ENOUGH_N)
    assert all(f"{ALONE_N:.1f} N are needed (1.5 times" in doubt for doubt in early)
    assert press.watch.waits
    assert press.alone == [True]
    assert steady(press, 3.0, fan=ENOUGH_N)[-5:] == [""] * 5
    assert press.alone == [True]
    assert "the propellers' push has no sensor" in press.words()
    press.watch.end()
    assert press.alone == [True, False]


def test_a_robot_that_moves_meanwhile_is_waited_for_anew_and_its_propellers_are_sent_their_force_again():
    press, slides_s = Press(WITHOUT), force_lost_after_s()
    steady(press, slides_s, fan=ENOUGH_N)
    assert press.doubt(fan=ENOUGH_N, sees_slide=False, moves=True)
    assert press.alone == [True, False]
    assert not press.watch.waits
    assert all(steady(press, slides_s, fan=ENOUGH_N))


@pytest.mark.parametrize(("blind_s", "goes_on"), [(0.2, True), (0.6, False)])
def test_a_camera_that_is_blind_for_a_moment_does_not_begin_it_anew(blind_s, goes_on):
    press = Press(WITHOUT)
    steady(press, 1.0, fan=ENOUGH_N)
    assert all(steady(press, blind_s, fan=ENOUGH_N, sees_slide=False))
    assert press.watch.waits is goes_on
    assert press.alone == ([True] if goes_on else [True, False])


def test_a_bench_that_goes_on_sends_them_their_force_all_the_time():
    press = Press(WITHOUT)
    press.watch.begin(for_good=False)
    assert steady(press, force_lost_after_s() + 3.0, fan=ENOUGH_N)[-1] == ""
    assert not any(press.alone)


def test_propellers_with_unknown_failure_are_no_ground():
    press = Press(WITHOUT, ThrustConfig())
    assert all(steady(press, 60.0, fan=ENOUGH_N))


def test_what_the_fan_alone_holds_needs_no_propellers():
    press = Press(WITHOUT)
    assert press.doubt(fan=1.02 * ALONE_N, sees_slide=False) == ""
    assert press.alone == []


@pytest.mark.parametrize("force_n", [0.7 * NEED_N, 0.9 * NEED_N])
def test_below_the_least_push_a_robot_slides_even_on_a_surface_that_is_a_little_better(force_n):
    better = replace(LIMITS.statics, friction=1.1 * LIMITS.statics.friction)
    least_n = least_push_n(LIMITS.statics, force_n, 20.0, 0.0)
    assert least_n < 20.0
    assert better.needed_n(0.99 * least_n, 0.0) > force_n


def test_a_force_with_which_a_better_surface_holds_alone_leaves_no_push_that_it_needs():
    assert least_push_n(LIMITS.statics, 0.95 * NEED_N, 20.0, 0.0) == 0.0


def test_propellers_that_report_count_by_what_they_report_and_while_they_do():
    enough_n = 1.02 * UNCONFIRMED * REPORTS.statics.needed_n(20.0, 0.0)
    press = Press(REPORTS)
    silent = "without the propellers: their controllers are silent"
    assert silent in press.doubt(fan=enough_n)
    assert press.doubt(fan=enough_n, push=20.0, sees_slide=False) == ""
    assert "with the 10.0 N that the propellers report" in press.doubt(fan=enough_n, push=10.0)
    assert press.doubt(fan=enough_n, push=20.0) == ""
    steady(press, STALE_S - 0.05, fan=enough_n)
    assert silent in steady(press, 0.15, fan=enough_n)[-1]
    assert "has no sensor" not in press.words()


@pytest.mark.parametrize(("heading_rad", "enough"), [(0.0, True), (0.25, False)])
def test_before_the_first_estimate_the_robot_is_turned_as_it_stood_at_the_start(heading_rad, enough):
    overrides = {"thrust.model": "vesc", "environment.start_pose": [0.0, 0.0, heading_rad]}
    config = load_bench("emulated", overrides=overrides)
    limits, stamp, force_n = adhesion_limits(config), Stamp(0, 0, 0), 24.0
    speed_rpm = limits.fan.rated_rpm * (force_n / limits.fan.rated_n) ** 0.5
    throttle = (limits.nominal_thrust_n / limits.full_thrust_n) ** 0.5
    halves = np.array([0.5 * (force_n + limits.zero_n)] * 2)
    samples = {
        "adhesion": AdhesionSample(stamp, speed_rpm, *[math.nan] * 6),
        "load_cells": LoadCellSample(stamp, halves, (Status.OK, Status.OK), (0, 0)),
        "thrust": ThrustSample(stamp, throttle, math.nan),
    }
    devices = SimpleNamespace(get=lambda name: SimpleNamespace(read=lambda: (samples[name],)))
    watch = press_watch(config, devices)
    watch.begin()
    assert (watch.doubt(0, sees_slide=True) == "") == enough
