"""Propellers behind VESCs: the emulated ones at the wire, their driver, and the robot they help to carry."""

import math
import re
from contextlib import contextmanager, suppress

import numpy as np
import pytest
from worlds import after, orders

import hil
from hil.bench.doctor.discovery import Discovery
from hil.bench.hold.preload import Preload
from hil.bench.loop_settings import thrust_wanted_n
from hil.config.adhesion import VescConfig
from hil.config.loading import load_bench
from hil.config.robot import RobotConfig
from hil.config.thrust_vesc import VescThrustConfig
from hil.core.device import Search
from hil.core.errors import ConfigError, DeviceError, DeviceTimeoutError, SafetyStop, UsageError
from hil.core.signals import Status
from hil.drivers.adhesion.vesc.model import Vesc
from hil.drivers.thrust.vesc.driver import VescThrust
from hil.drivers.thrust.vesc.model import VescPropellers
from hil.fakes.can_channel import CanChannel, WorldBus
from hil.fakes.motor_controllers.daemon_in_world import DaemonInWorld
from hil.fakes.plant import make_plant
from hil.fakes.thrust.vesc.chip import PropellerNode, VescThrustTruthOptions, propellers
from hil.fakes.world import VirtualClock, World
from hil.fan_daemon.fan_control import SetPoint
from hil.fan_daemon.protocols import protocol_of
from hil.fan_daemon.spec import Spec
from hil.faults.fault import parse_fault
from hil.faults.plan import FaultPlan
from hil.robot.trajectories import line

S = 1_000_000_000
CLIMB = line((0, 0, 0), (0.12, 0, 0), duration_s=4.0)
ON_VESCS = {"thrust.model": "vesc", "loop.rate_hz": 50.0}


@contextmanager
def made(*, faults=(), keys=None, messages=None, **options):
    """A world with propellers on a bus: (world, clock, nodes, driver, a client's bus)."""
    plan = FaultPlan([parse_fault(spec) for spec in faults])
    plant = make_plant(
        RobotConfig(), rng=np.random.default_rng(0), randomise_truth=False, faults=plan, by_hand=True
    )
    world = World(plant, seed=0, faults=plan)
    config = VescThrustConfig(interface="hil", channel="propellers", **(keys or {}))
    channel = CanChannel(world, "propellers", device="thrust").open()
    nodes = propellers(
        world, channel, messages or config, VescThrustTruthOptions(**{"start": "off", **options})
    )
    clock = VirtualClock(world)
    driver, bus = VescThrust(config, clock, DaemonInWorld(world).commander), WorldBus("propellers")
    try:
        yield world, clock, nodes, driver, bus
    finally:
        driver.close()
        bus.shutdown()
        channel.close()


def found_on_one_bus(ids, tmp_path):
    """What discovery makes of a bus with controllers of these ids, asked for fan and propellers."""
    with made(messages=VescThrustConfig(controller_ids=ids)) as (_world, clock, _nodes, _driver, _bus):
        bus = {"interface": "hil", "channel": "propellers", "open_timeout_s": 0.5}
        given = {"adhesion": [VescConfig(**bus)], "thrust": [VescThrustConfig(**bus)]}
        found = Discovery()
        search = Search(given, clock, lambda text: None, tmp_path, found.sections)
        for model in (Vesc(), VescPropellers()):
            if (answer := model.search(search)) is not None:
                found.take(model, answer)
        return found


def test_discovery_finds_them_beside_the_fans_and_its_file_can_be_read(tmp_path):
    found = found_on_one_bus((1, 2, 5), tmp_path)
    bus = {"interface": "hil", "channel": "propellers"}
    assert found.sections["adhesion"] == {**bus, "controller_id": 1}
    assert found.sections["thrust"] == {"model": "vesc", **bus, "controller_ids": [2, 5]}
    assert "controllers 2, 5 are taken for the propellers'" in found.notes
    (tmp_path / "found.toml").write_text(found.to_toml(), encoding="utf-8")
    assert load_bench(tmp_path / "found.toml").thrust.controller_ids == (2, 5)


def test_a_bus_with_the_fans_controller_alone_has_no_propellers(tmp_path):
    found = found_on_one_bus((7,), tmp_path)
    assert found.sections["adhesion"]["controller_id"] == 7
    assert "thrust" not in found.sections


def test_every_controller_is_given_the_same_command():
    spec = Spec("hil", "x", 2, also=(3, 5), device="thrust")
    frames = protocol_of(spec).encode(SetPoint("erpm", 60_000.0), 0)
    assert frames == tuple((3 << 8 | one, bytes.fromhex("0000EA60")) for one in (2, 3, 5))


def test_a_force_is_reached_by_both_and_reported_by_their_speed():
    with made() as (world, clock, nodes, driver, _):
        driver.open()
        after(driver, clock, 0.3)
        driver.set_force_n(22.0)
        newest = after(driver, clock, 4.0)[-1]
        world.sync_plant()
        gain = world.plant.working_point.propeller_gain
        assert sum(node.fan.force_n for node in nodes) == pytest.approx(gain * 22.0, rel=0.01)
        assert 39.7 * newest.throttle**2 == pytest.approx(22.0, rel=0.01)
        assert newest.speed_rpm == pytest.approx(9000 * math.sqrt(22.0 / 39.7), rel=0.01)
        assert newest.status is Status.OK


@pytest.mark.parametrize(
    ("keys", "options", "messages"),
    [
        ({"controller_ids": (2, 9)}, {}, r"no controller has the id 9; there: 2, 3.*thrust.controller_ids"),
        ({}, {"messages_1": (), "messages_2": ()}, r"controller 2 answers, but sends no status message"),
    ],
)
def test_controllers_that_cannot_be_trusted_are_named_with_the_remedy(keys, options, messages):
    there = VescThrustConfig(interface="hil", channel="propellers")
    with made(keys=keys, messages=there, **options) as (_, clock, _, driver, bus):
        with pytest.raises(DeviceError, match=messages) as caught:
            driver.open()
        assert (caught.value.exit_code, driver.identity()) == (3, {})
        clock.sleep_until_ns(clock.now_ns() + S)
        assert orders(bus) == [], "nothing was commanded, so nothing was switched off"


def test_the_doctor_names_the_controller_whose_settings_differ_with_the_remedy():
    with made(timeout_s=2.0) as (_, _, _, driver, _):
        driver.open()
        wrong = {f.check: f.remedy for f in driver.diagnose() if f.level != "ok"}
    assert wrong == {f"controller {one}: timeout": "set thrust.timeout_s = 2" for one in (2, 3)}


@pytest.mark.parametrize("force_n", [-1.0, math.nan, 50.0])
def test_a_force_that_cannot_be_meant_is_refused_and_the_push_goes_on(force_n):
    with made() as (_, clock, nodes, driver, _):
        driver.open()
        after(driver, clock, 0.3)
        driver.set_force_n(20.0)
        after(driver, clock, 3.0)
        with pytest.raises(UsageError, match=r"0 to 39.7 N"):
            driver.set_force_n(force_n)
        after(driver, clock, 0.5)
        assert sum(node.fan.force_n for node in nodes) > 18.0


def test_a_set_point_is_taken_back_to_the_one_before_not_to_a_place_on_its_ramp():
    config = VescThrustConfig()
    with made(faults=["thrust:wrong@0.5,factor=1.5"]) as (_, clock, _, driver, bus):
        driver.open()
        after(driver, clock, 0.3)
        driver.set_force_n(20.0)
        driver.set_force_n(35.0)
        after(driver, clock, 8.0)
        erpm = int.from_bytes(orders(bus)[-1][1], "big")
    assert erpm == pytest.approx(config.pole_pairs * config.speed_for_rpm(20.0), rel=0.01)


def test_a_set_point_that_waits_for_reports_that_agree_is_told():
    with made(faults=["thrust:wrong@0,factor=1.5"], start="running", timeout_s=30.0) as (
        _,
        clock,
        _,
        driver,
        _,
    ):
        driver.open()
        after(driver, clock, 1.0)
        driver.set_force_n(35.0)
        newest = after(driver, clock, 2.0)[-1]
    assert "waits" in newest.trouble


def test_one_controller_that_falls_silent_is_named():
    with made() as (_, clock, nodes, driver, _):
        driver.open()
        after(driver, clock, 0.3)
        nodes[1]._dead = True
        with pytest.raises(
            DeviceTimeoutError, match=r"no report of controller 3 for 1.0 s.*Secure the robot"
        ):
            after(driver, clock, 2.0)


@pytest.mark.parametrize(
    ("spec", "status"), [("thrust:stuck@1", Status.FROZEN), ("thrust:garbage@1", Status.IMPLAUSIBLE)]
)
def test_reports_that_cannot_be_true_are_marked(spec, status):
    with made(faults=[spec], start="running", timeout_s=30.0) as (_, clock, _, driver, _):
        driver.open()
        samples = after(driver, clock, 2.5)
        assert status in {s.status for s in samples}
        assert all(math.isnan(s.throttle) for s in samples if s.status is status)


@pytest.mark.parametrize("ids", [[], [2, 2], [2, 255]])
def test_controllers_that_cannot_be_are_named_by_their_key(ids):
    with pytest.raises(ConfigError, match=r"thrust.*controller_ids"):
        hil.open_bench("emulated", overrides={**ON_VESCS, "thrust.controller_ids": ids})


def test_nothing_moves_before_they_push_and_the_robot_is_held_at_the_end():
    cold = {**ON_VESCS, "emulation.adhesion.start": "tethered", "emulation.thrust.start": "tethered"}
    with hil.open_bench("emulated", seed=1, overrides=cold) as bench:
        wanted_n = thrust_wanted_n(bench.config)
        assert bench.world.plant.working_point is not None
        motion = bench.drive(line((0, 0, 0), (0.03, 0, 0), duration_s=1.5))
        newest = [s for r in motion.records for s in r.inputs.thrust][-1]
        assert 39.7 * newest.throttle**2 == pytest.approx(wanted_n, rel=0.02)
        world = bench.world
    assert bench.held.state == "HELD"
    world.advance_to(world.now_ns + 5 * S)
    assert not world.plant.truth().fallen


def test_propellers_that_do_not_come_up_leave_the_servos_without_torque():
    weak = {**ON_VESCS, "emulation.thrust.start": "off", "emulation.thrust.highest_a": 1.0}
    bench = hil.open_bench("emulated", seed=1, overrides=weak)
    with pytest.raises(SafetyStop, match=r"pushed up with \d+.\d N of 22.3") as caught:
        bench.__enter__()
    assert caught.value.reason == "adhesion"
    assert bench.world.plant.by_hand


def test_load_cells_whose_readings_are_old_press_nothing():
    """While the propellers came up, a reading of before the cells froze once counted until torque came on."""
    slow = {**ON_VESCS, "emulation.thrust.start": "off"}
    bench = hil.open_bench("emulated", seed=1, faults=["load_cells:stuck@0.6"], overrides=slow)
    with pytest.raises(SafetyStop) as caught:
        bench.__enter__()
    assert caught.value.reason == "adhesion"
    assert bench.world.plant.by_hand


def test_one_motor_that_loses_its_power_stops_the_robot_before_it_is_lost():
    with hil.open_bench("emulated", seed=1, overrides=ON_VESCS) as bench:
        node = next(part for part in bench.world._parts if isinstance(part, PropellerNode))

        def fail(record):
            if record.inputs.t_ns > 2 * S:
                node._strength = lambda t_ns: 0.25

        with pytest.raises(SafetyStop) as caught:
            bench.drive(CLIMB, feedback="odometry", on_cycle=fail)
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 2 * S)
        truth = bench.truth()
    assert caught.value.reason in ("adhesion", "utilisation")
    assert np.abs(truth.joint_velocity_rad_s[:4]).max() < 0.05
    assert not truth.fallen


def test_a_stop_for_want_of_force_names_propellers_that_report_too_little_push():
    faults = ("thrust:wrong@1.5,factor=0.5",)
    with hil.open_bench("emulated", seed=1, faults=faults, overrides=ON_VESCS) as bench:
        wanted_n = thrust_wanted_n(bench.config)
        with pytest.raises(SafetyStop) as caught:
            bench.drive(CLIMB, feedback="odometry")
        assert bench.truth().thrust_n == pytest.approx(wanted_n, rel=0.02)
    assert caught.value.reason in ("adhesion", "utilisation")
    reported_n = float(
        re.search(r"the propellers report (\d+\.\d) N of the 22\.3 N that", str(caught.value))[1]
    )
    assert 0.0 < reported_n < 0.85 * wanted_n


def stopped_by(fault, overrides=ON_VESCS):
    """The stop of a climb with a fault of the propellers, and the bench after it."""
    with hil.open_bench("emulated", seed=1, faults=(fault,), overrides=overrides) as bench:
        with pytest.raises(SafetyStop) as caught:
            bench.drive(CLIMB, feedback="odometry")
        t_ns = bench.clock.now_ns()
    return caught.value, t_ns, bench


def test_propellers_that_turn_faster_than_asked_stop_the_robot_and_count_as_no_push():
    stop, t_ns, bench = stopped_by("thrust:wrong@1.5,factor=1.3")
    assert stop.reason == "thrust_disagree"
    messages = r"propellers report 37\.\d N of push, more than the 22\.3 N that .* lost blade .*speed sensing"
    assert re.search(messages, str(stop))
    assert 1.7 * S < t_ns < 2.5 * S
    assert not bench.truth().fallen
    assert "without the propellers: they report 37." in bench.held.why
    assert "so that what they give is not known" in bench.held.why


def test_too_much_push_for_less_than_a_quarter_of_a_second_stops_nothing():
    faults = ("thrust:wrong@1.5+0.2,factor=1.3",)
    with hil.open_bench("emulated", seed=1, faults=faults, overrides=ON_VESCS) as bench:
        motion = bench.drive(CLIMB, feedback="odometry")
    assert bench.held.state == "HELD"
    reported = [39.7 * s.throttle**2 for r in motion.records for s in r.inputs.thrust]
    assert max(reported) > 37.0


@pytest.mark.parametrize("seed", [1, pytest.param(5, marks=pytest.mark.long)])
@pytest.mark.parametrize(
    "fault", ["brownout@1.5+0.1", *(pytest.param(f, marks=pytest.mark.long) for f in ("reset@1.5", "slow@1"))]
)
def test_a_supply_that_dips_is_no_propeller_that_turns_too_fast(seed, fault):
    throttles = []
    opened = hil.open_bench("emulated", seed=seed, faults=(f"thrust:{fault}",), overrides=ON_VESCS)
    with opened as bench, suppress(SafetyStop):
        bench.drive(
            CLIMB,
            feedback="odometry",
            on_cycle=lambda record: throttles.extend(s.throttle for s in record.inputs.thrust),
        )
    assert max(throttles) ** 2 * 39.7 < 1.05 * 22.3


def test_propellers_that_run_faster_than_a_bench_wants_are_slowed_before_anything_moves():
    """They go on as the last bench had them; the next one wants less."""
    fast = {"thrust.force_n": 22.3, "emulation.thrust.start": "off"}
    with hil.open_bench("emulated", seed=1, overrides={**ON_VESCS, **fast}) as bench:
        propellers = bench.devices.get("thrust")
        propellers.set_force_n(39.0)
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 3 * S)
        Preload(bench.config, bench.devices, bench.clock).hold()
        motion = bench.observe(1.0, feedback="odometry")
    assert max(s.throttle for r in motion.records for s in r.inputs.thrust) ** 2 * 39.7 < 1.15 * 22.3


def test_propellers_that_turn_too_fast_from_the_start_are_named_before_anything_moves():
    bench = hil.open_bench("emulated", seed=1, faults=("thrust:wrong@0,factor=1.3",), overrides=ON_VESCS)
    with pytest.raises(SafetyStop, match=r"pushed up with 37\.\d N of 22\.3 by their speed: a lost blade"):
        bench.__enter__()
    assert bench.world.plant.by_hand


def test_one_controller_that_says_nothing_stops_the_wheels():
    with hil.open_bench("emulated", seed=1, overrides=ON_VESCS) as bench:
        node = next(part for part in bench.world._parts if isinstance(part, PropellerNode))

        def hush(record):
            if record.inputs.t_ns > 2 * S:
                node._asleep = lambda t_ns: True

        with pytest.raises(SafetyStop) as caught:
            bench.drive(CLIMB, feedback="odometry", on_cycle=hush)
        truth = bench.truth()
    assert caught.value.reason == "stale_thrust"
    assert not truth.fallen
