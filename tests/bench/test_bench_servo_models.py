"""A bench of each servo model: emulated, discovered, examined and driven by its own table and motor."""

import sys

import numpy as np
import pytest

import hil
from hil.bench.doctor.discovery import discover
from hil.bench.doctor.examination import examine
from hil.bench.emulated_devices import build_world, connect_in_process
from hil.config.loading import load_bench
from hil.config.servo_models import servo_model
from hil.config.servos import ServosConfig
from hil.core.errors import ConfigError
from hil.core.signals import ServoSetpoint
from hil.drivers.servos.dynamixel.driver import DynamixelServos
from hil.fakes.plant.parameters import nominal_joints
from hil.fakes.world import VirtualClock

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

NUMBERS = (1000, 1010, 1020, 1030, 1040, 1050)
ALONE = dict.fromkeys(("encoders", "imu", "tracker", "mocap"))

each_model = pytest.mark.parametrize("number", NUMBERS)


def settings(number):
    supply = {"robot.supply_v": 24.0} if servo_model(number).recommended_v == 24.0 else {}
    return {**ALONE, "servos.model_number": number, **supply}


def bench_of(number, **overrides):
    config = load_bench("emulated_floor", overrides={**settings(number), **overrides})
    return hil.open_bench(config)


@each_model
def test_discovery_writes_down_a_bench_that_opens(number):
    """The file names the number, so that an exchanged servo is noticed."""
    config = load_bench("emulated_floor", overrides=settings(number))
    world = build_world(config, seed=1)
    connected = connect_in_process(config, world)
    clock = VirtualClock(world)
    found = discover(clock, ports=[connected.connections["servos"].values["port"]])
    tree = tomllib.loads(found.to_toml())
    assert tree["servos"]["model_number"] == number
    driver = DynamixelServos(ServosConfig(**tree["servos"]), clock)
    driver.open()
    assert driver.model is servo_model(number)
    driver.close()
    connected.close()
    assert (tree["servos"]["drive_ids"], tree["servos"]["steer_ids"]) == ([1, 2, 3, 4], [5, 6, 7, 8])


@each_model
def test_doctor_finds_nothing_to_mend(number):
    findings = list(examine(bench_of(number), watch_s=0.5))
    assert {f.level for f in findings if f.check != "limits"} == {"ok"}
    opened = next(f for f in findings if f.check == "open")
    assert f"{servo_model(number).name} ({number})" in opened.found
    limits = next(f for f in findings if f.check == "limits")
    table = servo_model(number).table
    amperes = table["current_limit"].default * servo_model(number).a_per_count
    assert f"{amperes:.2f} A" in limits.found
    slow = table["velocity_limit"].default * table["velocity_limit"].scale < 4.9
    assert limits.level == ("warning" if slow else "ok")


def test_doctor_knows_what_supply_a_model_wants():
    low = bench_of(1050, **{"emulation.servos.supply_v": 20.0})
    supply = next(f for f in examine(low, watch_s=0.3) if f.check == "supply")
    assert (supply.level, supply.expected) == ("warning", "at least 21.6 V")


@each_model
def test_the_emulated_robot_drives_with_the_models_motors(number):
    bench = bench_of(number)
    with bench:
        joints = bench.world.plant.parameters.joints
        nominal = nominal_joints(servo_model(number))
        np.testing.assert_allclose(joints.resistance_ohm, nominal.resistance_ohm)
        np.testing.assert_allclose(joints.torque_constant_n_m_a, nominal.torque_constant_n_m_a, rtol=0.011)
        servos = bench.devices.servos
        servos.enable()
        for _ in range(150):
            servos.read()
            servos.command(ServoSetpoint(np.full(4, 2.0), np.zeros(4)))
            bench.clock.sleep_until_ns(bench.clock.now_ns() + 10_000_000)
        rates = np.array([bench.world.plant.joints()[1][:4]])
        np.testing.assert_allclose(rates, 2.0, rtol=0.03)
        servos.stop()


def test_emulated_servos_without_a_model_number_are_those_of_the_recordings():
    config = load_bench("emulated_floor", overrides={**ALONE, "servos.model_number": None})
    with hil.open_bench(config) as bench:
        assert bench.devices.servos.identity()["model"] == "XH430-W210 (1010)"


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"servos.model_number": 1040}, r"robot\.supply_v: 11\.1 V is not for XH430-V350 servos.*16 to 30 V"),
        ({"servos.model_number": None, "robot.supply_v": 24.0}, r"24 V is not for XH430-W210"),
        ({"servos.model_number": 1060}, r"servos\.model_number: .*no control table for model 1060"),
    ],
)
def test_a_supply_or_model_that_cannot_be_meant_is_refused(values, said):
    with pytest.raises(ConfigError, match=said):
        load_bench("emulated_floor", overrides=values)


def test_servos_of_two_models_are_refused_by_an_emulated_bench():
    bench = bench_of(1010, **{"servos.model_number": None, "emulation.servos.model_by_joint": {"7": 1030}})
    failed = next(f for f in examine(bench, watch_s=0.3) if f.level == "failure")
    assert "steer_FR (ID 8): found model 1030 (XM430-W210)" in failed.found
