"""What a motor's measurements say about each other, judged by the emulated fan, which knows no checks."""

import math
from types import SimpleNamespace

import pytest
from worlds import ON, after, fan_world

from hil.config.adhesion import VescConfig
from hil.config.thrust_vesc import VescThrustConfig
from hil.core.registry import kinds
from hil.core.signals import AdhesionSample, Stamp
from hil.drivers.adhesion.vesc.driver import VescFan
from hil.fakes.motor_controllers.daemon_in_world import DaemonInWorld
from hil.fakes.motor_controllers.fan_physics import Demand, Fan
from hil.fakes.motor_controllers.true_parameters import AdhesionTruthOptions
from hil.fakes.thrust.vesc.chip import VescThrustTruthOptions, propellers
from hil.loop.checks.adhesion_limits import FanForces
from hil.robot.believed_force import CELLS, believe
from hil.robot.motor_cross_checks import (
    POWER,
    SPEED,
    VOLTAGE,
    Reading,
    Steadiness,
    cross_check,
    forces_n,
    impossible,
)

CONFIG = VescConfig()
RATINGS = CONFIG.ratings()


def fan_at(force_n, **options):
    fan = Fan(CONFIG, AdhesionTruthOptions(**options), 1.0)
    fan.begin(CONFIG.speed_for_rpm(force_n))
    return fan


def reads(fan, factor=1.0):
    """What the controller of a fan reports, its speed by a factor wrong."""
    return Reading(factor * fan.speed_rpm, fan.duty, fan.input_v, fan.motor_a, fan.input_a)


@pytest.mark.parametrize("poles", [n for k in range(1, 16) for n in (k, -k) if n != 3])
@pytest.mark.parametrize("force_n", [20.0, 45.0, 60.0])
def test_every_wrong_count_of_pole_pairs_is_named(poles, force_n):
    check = cross_check(RATINGS, reads(fan_at(force_n), poles / 3.0))
    assert (check.state, check.key) == ("contradicted", "adhesion.pole_pairs")
    assert round(check.says) == (poles if poles > 0 else -3)
    assert "adhesion.pole_pairs" in check.text


@pytest.mark.parametrize("factor", [-1.0, 0.3, 0.5, 0.67, 0.8, 1.2, 1.3, 1.6, 2.0, 3.0, 4.0])
def test_of_a_wrong_speed_the_force_by_the_others_counts(factor):
    forces = forces_n(RATINGS, reads(fan_at(45.0), factor))
    alone = believe(forces, 60.0)
    assert alone.force_n == pytest.approx(45.0, rel=0.1)
    assert not alone.confirmed
    with_cells = believe({**forces, CELLS: 44.0}, 60.0)
    assert with_cells.force_n == pytest.approx(44.0, rel=0.1)
    assert with_cells.confirmed
    assert (SPEED in with_cells.against) == (SPEED in forces)


@pytest.mark.parametrize("pack_v", [20.0, 23.4, 25.2])
@pytest.mark.parametrize("force_n", [15.0, 30.0, 45.0, 60.0])
def test_a_right_fan_is_never_contradicted_not_while_it_speeds_up_either(pack_v, force_n):
    fan = fan_at(10.0, pack_v=pack_v)
    assert cross_check(RATINGS, reads(fan)).state == "confirmed"
    fan.demand = Demand("duty", min(fan.duty_for(CONFIG.speed_for_rpm(force_n)), 0.95))
    for k in range(1, 200):
        fan.advance(20_000_000 * k)
        assert cross_check(RATINGS, reads(fan), steady=False).state == "confirmed"
    assert cross_check(RATINGS, reads(fan)).state == "confirmed"
    assert impossible(RATINGS, reads(fan)) is None


@pytest.mark.parametrize("spin_down_s", [0.3, 0.6])
@pytest.mark.parametrize("duty_per_s", [0.002, 0.005, 0.01, 0.02, 0.05, 0.1])
def test_a_right_fan_that_is_lowered_slowly_is_not_contradicted_by_its_power(duty_per_s, spin_down_s):
    fan = fan_at(45.0, spin_down_s=spin_down_s)
    steadiness, highest = Steadiness(RATINGS), fan.duty
    least = fan.duty_for(CONFIG.speed_for_rpm(10.0))
    for k in range(1, 20_000):
        duty = highest - duty_per_s * 0.02 * k
        if duty < least:
            break
        fan.demand = Demand("duty", duty)
        fan.advance(20_000_000 * k)
        steady = steadiness.follow(20_000_000 * k, reads(fan))
        assert cross_check(RATINGS, reads(fan), steady=steady).state == "confirmed"


def test_a_rated_speed_of_another_fan_is_seen_by_the_power():
    other = VescConfig(rated_rpm=20_000.0)
    now = reads(fan_at(20.0))
    check = cross_check(other.ratings(), now)
    assert (check.state, check.key) == ("contradicted", "adhesion.rated_rpm")
    assert check.says == pytest.approx(30_000.0, rel=0.05)


def test_without_anything_to_compare_nothing_is_confirmed():
    check = cross_check(RATINGS, Reading(30_000.0, 0.8))
    assert check.state == "unconfirmed"
    assert believe({SPEED: 45.0}, 60.0) == (45.0, SPEED, False, {})


@pytest.mark.parametrize(
    ("forces", "force_n", "by", "confirmed"),
    [
        ({SPEED: 45.0, CELLS: 44.0}, 44.0, CELLS, True),
        ({SPEED: 80.0, CELLS: 44.0, VOLTAGE: 46.0}, 44.0, CELLS, True),
        ({SPEED: 45.0, CELLS: 27.0, VOLTAGE: 45.0, POWER: 45.0}, 27.0, CELLS, False),
        ({SPEED: 45.0, VOLTAGE: 25.0, POWER: 26.0}, 25.0, VOLTAGE, False),
        ({SPEED: 45.0, VOLTAGE: 25.0}, 25.0, VOLTAGE, False),
        ({VOLTAGE: 45.0, POWER: 44.0}, 45.0, VOLTAGE, False),
        ({VOLTAGE: 45.0, POWER: 5.0}, math.nan, "", False),
        ({CELLS: 271.0}, math.nan, "", False),
        ({SPEED: 271.0, CELLS: 44.0}, 44.0, CELLS, False),
    ],
)
def test_which_force_counts(forces, force_n, by, confirmed):
    found = believe(forces, 60.0)
    assert (found.force_n, found.by, found.confirmed) == (pytest.approx(force_n, nan_ok=True), by, confirmed)


@pytest.mark.parametrize(
    ("command", "factor"),
    [
        ("duty", 1.1),
        ("duty", 2.0),
        *(pytest.param("duty", f, marks=pytest.mark.long) for f in (-1.0, 0.3, 1.2, 1.3, 1.6, 4.0)),
        ("current", 2.0),
        ("rpm", 1.3),
    ],
)
def test_no_single_report_lowers_a_fan_that_runs(command, factor):
    on = {**ON, "start": "running"}
    with fan_world(faults=[f"adhesion:wrong@3,factor={factor}"], **on) as (_world, clock, node, _bus):
        config = VescConfig(interface="hil", channel="fan", command=command)
        fan = VescFan(config, clock, DaemonInWorld(clock._world).commander)
        fan.open()
        after(fan, clock, 0.3)
        fan.set_force_n(45.0)
        after(fan, clock, 2.7)
        before_n, lowest_n = node.fan.force_n, math.inf
        for _ in range(40):
            after(fan, clock, 0.1)
            lowest_n = min(lowest_n, node.fan.force_n)
        assert before_n == pytest.approx(45.0, rel=0.03)
        assert lowest_n > 0.95 * before_n
        fan.brace()
        after(fan, clock, 3.0)
        assert node.fan.force_n > 55.0, "what can press, presses, whatever the speed says"
        fan.close()


def test_propellers_that_answer_at_the_fans_id_are_told_apart_by_what_they_do():
    with fan_world(**ON) as (world, clock, _fan, _bus):
        thrust = VescThrustConfig(interface="hil", channel="fan")
        options = VescThrustTruthOptions(messages_1=(1,), messages_2=(4, 5), start="off")
        channel = next(iter(world._parts))._channel
        propellers(world, channel, thrust, options)
        config = VescConfig(interface="hil", channel="fan", controller_id=2)
        fan, forces = VescFan(config, clock, DaemonInWorld(world).commander), FanForces(config.ratings())
        fan.open()
        after(fan, clock, 0.5)
        fan.set_force_n(45.0)
        found = []
        for sample in after(fan, clock, 4.0):
            forces.take(sample)
            found.append(forces.contradiction)
        assert all(found[-20:])
        fan.close()


def test_the_doctor_names_the_pole_pairs_and_not_a_force():
    def looked_at(factor):
        now = reads(fan_at(45.0), factor)
        sample = AdhesionSample(Stamp(0, 0, 0), *now[:2], now.motor_a, now.input_a, now.input_v, 40.0, 30.0)
        watched = SimpleNamespace(samples=[sample] * 5, config=CONFIG, due=5)
        return next(f for f in kinds()["adhesion"].check(watched) if f.check == "speed")

    assert looked_at(1.0).level == "ok"
    wrong = looked_at(4.0 / 3.0)
    assert wrong.level == "failure"
    assert "4 would fit" in wrong.found
