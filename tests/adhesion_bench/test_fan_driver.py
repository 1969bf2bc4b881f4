"""The fan's driver: what it finds on the bus, what it refuses, and the force that it keeps up."""

import math

import pytest
from worlds import ON, after, fan_world, orders

from hil.config.adhesion import VescConfig
from hil.core.errors import DeviceError, DeviceTimeoutError, UsageError
from hil.core.signals import Status
from hil.drivers.adhesion.vesc.driver import VescFan
from hil.fakes.motor_controllers.daemon_in_world import DaemonInWorld
from hil.fakes.motor_controllers.true_parameters import AdhesionTruthOptions
from hil.fakes.motor_controllers.vesc_node import VescNode

S = 1_000_000_000


@pytest.fixture
def driver():
    """Makes drivers, which are closed at the end."""
    made = []

    def make(clock, **keys):
        config = VescConfig(**{"interface": "hil", "channel": "fan", **keys})
        made.append(VescFan(config, clock, DaemonInWorld(clock._world).commander))
        return made[-1]

    yield make
    for fan in made:
        fan.close()


@pytest.mark.parametrize("command", ["duty", "current", "rpm"])
def test_a_force_is_reached_and_kept_up_whatever_the_battery_does(command, driver):
    with fan_world(**ON, pack_v=22.0) as (world, clock, _node, _bus):
        fan = driver(clock, command=command)
        fan.open()
        after(fan, clock, 0.3)
        fan.set_force_n(40.0)
        samples = after(fan, clock, 8.0)
        world.sync_plant()
        assert world.plant.truth().adhesion_n == pytest.approx(40.0, rel=0.02)
        assert fan._config.force_at_n(samples[-1].speed_rpm) == pytest.approx(40.0, rel=0.02)
        assert samples[-1].input_v == pytest.approx(21.5, abs=0.3)
        fan.close()


@pytest.mark.parametrize("command", ["duty", "current"])
def test_a_slow_ramp_is_waited_for_and_nothing_overshoots(command, driver):
    with fan_world(**ON) as (_world, clock, node, _bus):
        fan = driver(clock, command=command, ramp_up_s=8.0)
        fan.open()
        after(fan, clock, 0.3)
        fan.set_force_n(40.0)
        highest_n = 0.0
        for _ in range(120):
            after(fan, clock, 0.1)
            highest_n = max(highest_n, node.fan.force_n)
        assert highest_n < 42.0
        assert node.fan.force_n == pytest.approx(40.0, rel=0.02)


def test_opening_and_closing_commands_nothing(driver):
    with fan_world(**ON) as (_world, clock, _node, bus):
        fan = driver(clock)
        fan.open()
        after(fan, clock, 0.5)
        fan.close()
        assert orders(bus) == []


def test_slow_reports_are_no_numbers_before_they_came(driver):
    with fan_world(**{**ON, "messages_2": ()}) as (_world, clock, _node, _bus):
        fan = driver(clock)
        fan.open()
        newest = after(fan, clock, 0.5)[-1]
        assert newest.status is Status.OK
        assert all(math.isnan(v) for v in (newest.input_a, newest.input_v, newest.fet_c, newest.motor_c))


@pytest.mark.parametrize(
    ("options", "keys", "reported"),
    [
        (ON, {"controller_id": 9}, r"no controller has the id 9; there: 1.*set adhesion.controller_id to 1"),
        ({**ON, "twins": 1}, {}, r"2 controllers have the id 1.*an id of its own in VESC Tool"),
        (
            {"start": "off", "messages_1": (), "messages_2": ()},
            {},
            r"sends no status message.*switch on messages 1, 4 and 5 in VESC Tool",
        ),
        ({**ON, "timeout_s": 0.0}, {}, r"timeout is 0.*set 1000 ms in VESC Tool"),
        ({**ON, "timeout_s": 0.2}, {}, r"timeout of 0.2 s is too short.*set 1000 ms in VESC Tool"),
    ],
)
def test_a_controller_that_cannot_be_trusted_is_named_with_the_remedy(options, keys, reported, driver):
    with fan_world(**options) as (_world, clock, _node, bus):
        fan = driver(clock, **keys)
        with pytest.raises(DeviceError, match=reported) as caught:
            fan.open()
        assert caught.value.exit_code == 3
        assert not fan.identity()
        clock.sleep_until_ns(clock.now_ns() + S)
        assert orders(bus) == [], "nothing was commanded, so nothing was switched off"


def test_a_silent_bus_is_named_with_its_bit_rate(driver):
    reported = pytest.raises(DeviceTimeoutError, match=r"no VESC answers.*adhesion.bitrate = 500000")
    with fan_world(faults=["adhesion:baud_mismatch"], **ON) as (_w, clock, _n, _b), reported:
        driver(clock).open()


@pytest.mark.parametrize("force_n", [0.0, math.nan, 500.0])
def test_a_force_that_cannot_be_meant_is_refused_and_the_fan_goes_on(force_n, driver):
    with fan_world(**ON) as (_world, clock, node, _bus):
        fan = driver(clock)
        fan.open()
        after(fan, clock, 0.3)
        fan.set_force_n(40.0)
        after(fan, clock, 3.0)
        with pytest.raises(UsageError, match=r"above 0, at most 60 N"):
            fan.set_force_n(force_n)
        after(fan, clock, 0.5)
        assert node.fan.force_n == pytest.approx(40.0, rel=0.03)


def test_a_bus_that_falls_silent_says_when_the_motor_is_let_go_of(driver):
    with fan_world(faults=["adhesion:unplug@2"], **ON) as (_world, clock, _node, _bus):
        fan = driver(clock)
        fan.open()
        with pytest.raises(DeviceTimeoutError, match=r"no report.*for 1 s it lets go.*Secure the robot"):
            after(fan, clock, 4.0)


@pytest.mark.parametrize(
    ("spec", "status"), [("adhesion:stuck@1", Status.FROZEN), ("adhesion:garbage@1", Status.IMPLAUSIBLE)]
)
def test_reports_that_cannot_be_true_are_marked(spec, status, driver):
    with fan_world(faults=[spec], **{**ON, "start": "running", "timeout_s": 30.0}) as (_w, clock, _n, _b):
        fan = driver(clock, timeout_s=30.0)
        fan.open()
        samples = after(fan, clock, 2.5)
        assert status in {s.status for s in samples}
        assert all(math.isnan(s.speed_rpm) for s in samples if s.status is status)


def test_a_battery_and_a_heat_that_cannot_be_are_not_reported(driver):
    """They come in messages of their own, and stay until the next of them, beside samples that are well."""
    on = {**ON, "start": "running", "timeout_s": 30.0, "messages_2": (4, 5), "rate_2_hz": 10.0}
    with fan_world(faults=["adhesion:garbage@1+0.2"], **on) as (_w, clock, _n, _b):
        fan = driver(clock, timeout_s=30.0)
        fan.open()
        samples = after(fan, clock, 2.5)
    assert all(math.isnan(s.input_v) or 20.0 <= s.input_v <= 25.0 for s in samples)
    assert all(math.isnan(s.fet_c) or -60.0 <= s.fet_c <= 250.0 for s in samples)
    assert samples[-1].input_v > 10.0


def test_the_doctor_reads_time_out_messages_and_firmware_from_the_controller(driver):
    with fan_world(**{**ON, "messages_2": (4,)}, timeout_s=2.0, firmware="5.02") as (_w, clock, _n, _b):
        fan = driver(clock)
        fan.open()
        found = {f.check: f for f in fan.diagnose()}
        assert (found["timeout"].level, found["timeout"].found) == ("warning", "2 s")
        assert (found["status messages"].level, found["status messages"].found) == ("warning", "1, 4")
        assert (found["firmware"].level, found["firmware"].found) == ("warning", "5.02")
        assert found["daemon"].level == "ok"
        assert found["daemon"].found == "it is at rest: no command is sent before a force is asked for"
        after(fan, clock, 0.3)
        fan.set_force_n(40.0)
        after(fan, clock, 1.0)
        (daemon,) = (f for f in fan.diagnose() if f.check == "daemon")
        assert (daemon.level, daemon.found) == ("ok", "keeps it running")


def test_a_daemon_that_cannot_send_is_reported_with_a_remedy(driver):
    with fan_world(faults=["adhesion:unplug@1"], **ON) as (_world, clock, _node, _bus):
        fan = driver(clock)
        fan.open()
        after(fan, clock, 0.3)
        fan.set_force_n(40.0)
        clock.sleep_until_ns(2 * S)
        (daemon,) = (f for f in fan.diagnose() if f.check == "daemon")
    assert (daemon.level, daemon.remedy) == ("warning", "`hil adhesion status` says more"), daemon


def test_a_fan_that_runs_is_taken_over_without_a_step(driver):
    with fan_world(**{**ON, "start": "running"}) as (_world, clock, node, _bus):
        fan = driver(clock)
        fan.open()
        after(fan, clock, 0.3)
        fan.set_force_n(45.0)
        lowest = 100.0
        for _ in range(300):
            after(fan, clock, 0.01)
            lowest = min(lowest, node.fan.force_n)
        assert lowest > 43.5


def test_two_fans_on_one_bus_do_not_disturb_each_other(driver):
    with fan_world(**ON) as (world, clock, node, _bus):
        other = VescNode(
            world, node._channel, VescConfig(controller_id=2), AdhesionTruthOptions(**ON), "fan2"
        )
        fan = driver(clock, controller_id=2)
        fan.open()
        after(fan, clock, 0.3)
        fan.set_force_n(30.0)
        after(fan, clock, 4.0)
        assert other.fan.force_n == pytest.approx(30.0, rel=0.03)
        assert node.fan.force_n == 0.0
