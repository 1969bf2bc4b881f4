"""What the daemon sends, as a function of time: it holds, it ramps, never steps, never ends by itself."""

import itertools
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.config.adhesion import VescConfig
from hil.core.clock import nanoseconds
from hil.core.errors import ConfigError, DeviceError, UsageError
from hil.fakes.motor_controllers.fan_physics import Demand, Fan
from hil.fakes.motor_controllers.true_parameters import AdhesionTruthOptions
from hil.fan_daemon.fan_control import RELEASE, FanControl, SetPoint
from hil.fan_daemon.spec import Spec

SPEC = Spec("udp_multicast", "239.74.164.9", 7)
PERIOD_NS = nanoseconds(SPEC.period_s)
HOUR_NS = nanoseconds(3600.0)
AT_REST = {"duty": 0.0, "current_a": 0.0, "erpm": 0.0}


def report(control, t_ns, controller_id=7, **figures):
    """A status as a VESC's is understood."""
    running = SetPoint("duty", figures["duty"]) if figures.get("duty") else None
    control.reported(t_ns, controller_id, {**AT_REST, **figures}, running)


def daemon_at(t_ns, **figures):
    """A daemon that has just heard its fan."""
    control = FanControl(SPEC)
    control.next_command(0)
    for _ in range(2):
        report(control, t_ns, **figures)
    return control


def orders(control, start_ns, duration_s):
    times = range(start_ns, start_ns + nanoseconds(duration_s), PERIOD_NS)
    return [(t_ns, control.next_command(t_ns)) for t_ns in times]


def steps(given):
    values = [order.value for _, order in given if order is not None and order.quantity == "duty"]
    return [after - before for before, after in itertools.pairwise(values)]


def test_a_set_point_is_reached_along_a_ramp_and_kept_for_good():
    control = daemon_at(0)
    control.set_target(0, SetPoint("duty", 0.57))
    rising = orders(control, 0, 2.0)
    largest = PERIOD_NS / 1e9 * SPEC.highest["duty"] / SPEC.ramp_up_s
    assert 0.0 < max(steps(rising)) <= largest * 1.001
    assert rising[-1][1] == SetPoint("duty", 0.57)
    control.next_command(HOUR_NS)
    assert control.next_command(HOUR_NS + PERIOD_NS) == SetPoint("duty", 0.57)
    assert control.state() == "keeping"


def test_a_fan_that_runs_is_taken_over_without_a_step():
    control = daemon_at(PERIOD_NS, duty=0.571)
    assert [order for _, order in orders(control, PERIOD_NS, 1.0)] == [SetPoint("duty", 0.571)] * 20


@pytest.mark.parametrize("first", ["report", "order"])
def test_what_another_program_sends_is_taken_over_exactly(first):
    control = FanControl(SPEC)
    heard = [
        lambda: report(control, PERIOD_NS, duty=0.571),
        lambda: control.observe_command(PERIOD_NS, SetPoint("erpm", 57123.0)),
    ]
    for hear in heard if first == "report" else heard[::-1]:
        hear()
    assert control.next_command(PERIOD_NS) == SetPoint("erpm", 57123.0)


def test_a_fan_commanded_by_another_program_is_followed_until_the_daemon_is_asked():
    control = FanControl(SPEC)
    control.observe_command(0, SetPoint("duty", 0.5))
    control.observe_command(nanoseconds(60.0), SetPoint("duty", 0.6))
    assert control.next_command(nanoseconds(60.0)) == SetPoint("duty", 0.6)
    assert control.next_command(nanoseconds(120.0)) == SetPoint("duty", 0.6)
    control.set_target(nanoseconds(120.0), SetPoint("duty", 0.6))
    control.observe_command(nanoseconds(121.0), SetPoint("duty", 0.2))
    assert control.next_command(nanoseconds(121.0)) == SetPoint("duty", 0.6)


def test_a_fan_that_its_owner_stops_is_not_kept_running():
    control = FanControl(SPEC)
    control.observe_command(0, SetPoint("duty", 0.5))
    control.observe_command(nanoseconds(1.0), SetPoint("current_a", 0.0))
    report(control, nanoseconds(1.0), duty=0.3)
    assert control.next_command(nanoseconds(1.0)) is None
    assert control.state() == "idle"


def test_only_a_new_daemon_takes_a_fan_over():
    control = FanControl(SPEC)
    control.next_command(0)
    report(control, nanoseconds(1.6), duty=0.5)
    control.observe_command(nanoseconds(1.6), SetPoint("duty", 0.5))
    assert control.next_command(nanoseconds(1.6)) is None


def test_a_fan_that_runs_by_another_hand_is_asked_for_more_without_a_step():
    control = daemon_at(nanoseconds(5.0), duty=0.4)
    control.set_target(nanoseconds(5.0), SetPoint("duty", 0.5))
    assert control.next_command(nanoseconds(5.0)).value == pytest.approx(0.4)


def test_another_quantity_begins_where_the_fan_is():
    control = daemon_at(0, duty=0.57, erpm=57000.0)
    control.set_target(0, SetPoint("erpm", 60000.0))
    assert control.next_command(0) == SetPoint("erpm", 57000.0)


@pytest.mark.parametrize("damaged", range(5))
def test_one_damaged_report_lowers_no_fan_whose_quantity_changes(damaged):
    control = daemon_at(0, duty=0.57, erpm=57000.0)
    control.set_target(0, SetPoint("erpm", 57000.0))
    for k in range(5):
        report(control, nanoseconds(0.02 * k), duty=0.057 if k == damaged else 0.57, erpm=57000.0)
    control.set_target(nanoseconds(0.1), SetPoint("duty", 0.57))
    assert control.next_command(nanoseconds(0.1)) == SetPoint("duty", 0.57)


def test_a_fan_is_taken_over_by_two_reports_that_agree():
    control = FanControl(SPEC)
    report(control, 0, duty=0.057)
    assert control.next_command(0) is None
    report(control, nanoseconds(0.02), duty=0.571)
    assert control.next_command(nanoseconds(0.02)) is None
    report(control, nanoseconds(0.04), duty=0.57)
    assert control.next_command(nanoseconds(0.04)) == SetPoint("duty", 0.571)


def test_off_is_a_ramp_then_a_release_then_silence():
    control = daemon_at(0, duty=0.6)
    control.end(0)
    assert control.state() == "ending"
    given = orders(control, 0, 6.0)
    largest = PERIOD_NS / 1e9 * SPEC.highest["duty"] / SPEC.ramp_down_s
    assert -largest * 1.001 <= min(steps(given))
    assert max(steps(given)) <= 0.0
    said = [order for _, order in given]
    assert said.count(RELEASE) >= 5
    assert said[-1] is None
    assert control.state() == "idle"


def test_after_off_a_fan_that_still_turns_is_not_taken_over_again():
    control = daemon_at(0, duty=0.03)
    control.end(0)
    orders(control, 0, 0.3)
    report(control, nanoseconds(0.3), duty=0.03)
    assert control.next_command(nanoseconds(0.3)) == RELEASE


def test_a_set_point_calls_off_an_end():
    control = daemon_at(0, duty=0.6)
    control.end(0)
    down = orders(control, 0, 1.0)
    control.set_target(nanoseconds(1.0), SetPoint("duty", 0.6))
    up = orders(control, nanoseconds(1.0), 2.0)
    assert max(map(abs, steps(down + up))) < 0.03
    assert up[-1][1] == SetPoint("duty", 0.6)


def test_a_daemon_that_was_suspended_goes_on_without_a_step():
    control = daemon_at(0, duty=0.5)
    before = control.next_command(0)
    control.set_target(0, SetPoint("duty", 0.9))
    after = control.next_command(nanoseconds(60.0))
    assert after.value - before.value <= 0.2 * SPEC.highest["duty"] / SPEC.ramp_up_s + 1e-9


@given(st.lists(st.one_of(st.floats(0.01, 0.95), st.just("end")), max_size=20), st.data())
def test_whatever_is_asked_no_command_steps(wishes, data):
    control = daemon_at(0)
    t_ns, given = 0, []
    for wish in wishes:
        report(control, t_ns, duty=control.sent.value if control.sent else 0.0)
        control.end(t_ns) if wish == "end" else control.set_target(t_ns, SetPoint("duty", wish))
        duration_s = data.draw(st.floats(0.0, 3.0))
        given += orders(control, t_ns, duration_s)
        t_ns += nanoseconds(duration_s)
    assert all(abs(step) <= 0.0238 for step in steps(given))


@pytest.mark.parametrize("value", [0.0, math.nan, 0.96])
def test_impossible_set_points_are_refused_and_change_nothing(value):
    control = daemon_at(0, duty=0.5)
    with pytest.raises(UsageError, match="duty, current_a, erpm"):
        control.set_target(0, SetPoint("force", 45.0))
    with pytest.raises(UsageError, match="adhesion set-point duty"):
        control.set_target(0, SetPoint("duty", value))
    assert control.next_command(PERIOD_NS) == SetPoint("duty", 0.5)


def test_a_fan_that_says_nothing_is_not_started():
    control = FanControl(SPEC)
    with pytest.raises(DeviceError, match="switch on status messages 1, 4 and 5") as raised:
        control.set_target(0, SetPoint("duty", 0.5))
    assert "controller 7 sends no status" in str(raised.value)
    assert control.next_command(PERIOD_NS) is None


def test_the_wrong_controller_id_is_named_beside_the_right_one():
    control = FanControl(SPEC)
    report(control, 0, 23, duty=0.5)
    assert control.next_command(0) is None, "another fan is left alone"
    with pytest.raises(DeviceError, match="controller 23 does"):
        control.set_target(0, SetPoint("duty", 0.5))


def test_a_kept_fan_that_falls_silent_is_kept():
    control = daemon_at(0, duty=0.5)
    assert control.next_command(HOUR_NS) == SetPoint("duty", 0.5)
    control.set_target(HOUR_NS, SetPoint("duty", 0.6))
    assert control.next_command(HOUR_NS + PERIOD_NS).value > 0.5


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"timeout_s": 0.0}, "run for ever"),
        ({"timeout_s": 0.3}, "too short for commands every 0.05 s"),
        ({"ramp_down_s": 0.0}, "ramp_down_s"),
        ({"ramp_up_s": math.nan}, "finite"),
    ],
)
def test_times_that_would_let_go_of_the_robot_are_refused(change, said):
    with pytest.raises(ConfigError, match=said) as refused:
        Spec("socketcan", "can0", 7, **change)
    assert refused.value.remedy


def test_a_spec_survives_the_way_to_the_process():
    assert Spec.from_json(SPEC.to_json()) == SPEC
    with pytest.raises(ConfigError, match="the daemon's start"):
        Spec.from_json('{"interface": "socketcan", "wheels": 4}')


def kept(duration_s, *, pack_ah=1000.0, report=lambda figures: figures, after_s=5.0):
    """First and last force of a fan that a daemon keeps on a battery of some charge, and the daemon."""
    fan = Fan(VescConfig(), AdhesionTruthOptions(pack_ah=pack_ah), 1.0)
    fan.begin(30_000.0)
    control, first_n = FanControl(replace(SPEC, highest={"duty": 0.95})), fan.force_n
    control.resume(0, SetPoint("duty", fan.duty), SetPoint("duty", fan.duty))
    for k in range(round(duration_s / SPEC.period_s)):
        t_ns = k * PERIOD_NS
        fan.demand = Demand("duty", control.next_command(t_ns).value)
        fan.advance(t_ns)
        figures = {"duty": fan.duty, "erpm": 3.0 * fan.speed_rpm}
        if k % 4 == 0:
            figures["input_v"] = fan.input_v
        control.reported(t_ns, 7, report(figures) if t_ns > nanoseconds(after_s) else figures, None)
    return first_n, fan.force_n, control


def test_the_force_stays_while_the_battery_sags():
    first_n, last_n, control = kept(120.0, pack_ah=2.0)
    assert last_n == pytest.approx(first_n, rel=0.02)
    assert not control.trim.sag
    assert control.aim.value > 1.05 * control.target.value, "whoever takes over goes on from there"


@pytest.mark.parametrize(
    "wrong", [{"input_v": 0.7}, {"input_v": 1.4}, {"erpm": 0.5}, {"erpm": 2.0}, {"erpm": -1.0}]
)
def test_one_wrong_report_changes_nothing(wrong):
    def report(figures):
        return {name: value * wrong.get(name, 1.0) for name, value in figures.items()}

    first_n, last_n, _ = kept(30.0, report=report)
    assert last_n == pytest.approx(first_n, rel=0.01)


def test_one_wrong_speed_when_the_fan_settles_leaves_no_fan_to_sag():
    reports = itertools.count()

    def report(figures):
        return figures | {"erpm": figures["erpm"] * (0.5 if next(reports) == 0 else 1.0)}

    first_n, last_n, _ = kept(120.0, pack_ah=2.0, report=report, after_s=1.96)
    assert last_n == pytest.approx(first_n, rel=0.02)


def test_a_battery_that_cannot_keep_the_force_is_told():
    first_n, last_n, control = kept(100.0, pack_ah=1.0)
    assert last_n < 0.97 * first_n
    assert "the battery sags to" in control.trim.sag
