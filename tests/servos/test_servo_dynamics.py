"""What was measured on the robot, recovered from the emulated servos on the emulated robot body."""

import math
import struct

import numpy as np
import pytest
from servo_client import ALL, RAD_PER_COUNT, RAD_S_PER_COUNT, READ, SYNC_WRITE, Client, word
from servo_wire import Wire

from hil.config.robot import RobotConfig
from hil.core.signals import ServoSetpoint
from hil.drivers.servos.dynamixel.packets import find_statuses, instruction
from hil.fakes.plant import make_plant
from hil.fakes.servos.dynamixel.chip import ServoBus
from hil.fakes.servos.dynamixel.true_parameters import ServoBusOptions
from hil.fakes.world import World

STEP_NS = 1_000_000


@pytest.fixture(scope="module")
def robot_wire():
    """Factory of a bus on the nominal robot on a floor."""

    def build(**options):
        plant = make_plant(
            RobotConfig(), surface="floor", tilt_rad=0.0, rng=np.random.default_rng(1), randomise_truth=False
        )
        world = World(plant, seed=1)
        return Wire(world, ServoBus(world, options=ServoBusOptions(**options)))

    return build


def drive_all(bench, counts):
    goal = counts.to_bytes(4, "little", signed=True)
    parts = b"".join(bytes((servo_id,)) + goal for servo_id in range(1, 5))
    bench.send(instruction(ALL, SYNC_WRITE, word(104) + word(4) + parts), wait_ns=0)


def show(bench):
    """Present current, velocity and position of drive FL, raw, without letting time pass."""
    request = instruction(1, READ, word(126) + word(10))
    (reply,) = bench.bus.receive(request, bench.world.now_ns, bench.baud)
    return struct.unpack("<hii", find_statuses(reply.data)[0][1].data)


def watch(bench, duration_s):
    """True rate and shown velocity and position of drive FL every millisecond."""
    rows, world = [], bench.world
    end_ns = world.now_ns + round(duration_s * 1e9)
    while world.now_ns < end_ns:
        world.advance_to(world.now_ns + STEP_NS)
        world.sync_plant()
        position, velocity, _ = world.plant.joints()
        _, shown, counts = show(bench)
        rows.append((world.now_ns, velocity[0], position[0], shown * RAD_S_PER_COUNT, counts))
    return np.array(rows).T


def crossing(t_ns, values, level):
    """When a falling signal passes a level for good, ms."""
    above = np.nonzero(values > level)[0][-1]
    return t_ns[above] * 1e-6


def fall_ms(t_ns, values, before):
    return crossing(t_ns, values, 0.1 * before) - crossing(t_ns, values, 0.9 * before)


@pytest.fixture(scope="module")
def stopping(robot_wire):
    """Driving at 1.97 rad/s, then stopping: the manoeuvre of the recordings."""
    bench = robot_wire()
    for servo_id in range(1, 9):
        Client(bench, servo_id).put("torque_enable", 1)
    drive_all(bench, 82)
    Client(bench).wait(2.0)
    steady = watch(bench, 2.0)
    drive_all(bench, 0)
    return steady, watch(bench, 0.6)


def test_the_true_rate_falls_in_72_ms(stopping):
    steady, fall = stopping
    assert fall_ms(fall[0], fall[1], steady[1].mean()) == pytest.approx(72, abs=10)


def test_the_reported_rate_falls_in_94_ms(stopping):
    steady, fall = stopping
    assert fall_ms(fall[0], fall[3], steady[3].mean()) == pytest.approx(94, abs=12)


def test_present_velocity_lags_the_encoder_by_52_ms(stopping):
    steady, fall = stopping
    before = steady[1].mean()
    lag = crossing(fall[0], fall[3], 0.5 * before) - crossing(fall[0], fall[1], 0.5 * before)
    assert lag == pytest.approx(52, abs=10)


def test_present_velocity_is_truncated_by_half_a_count(stopping):
    steady, _ = stopping
    true = (steady[2][-1] - steady[2][0]) / ((steady[0][-1] - steady[0][0]) * 1e-9)
    assert (true - steady[3].mean()) / RAD_S_PER_COUNT == pytest.approx(0.5, abs=0.25)
    assert set(np.rint(steady[3] / RAD_S_PER_COUNT)) <= {80, 81, 82, 83}


def test_reverse_is_truncated_towards_zero_too(robot_wire):
    bench = robot_wire()
    for servo_id in range(1, 9):
        Client(bench, servo_id).put("torque_enable", 1)
    drive_all(bench, -82)
    Client(bench).wait(1.0)
    rows = watch(bench, 2.0)
    true = (rows[2][-1] - rows[2][0]) / ((rows[0][-1] - rows[0][0]) * 1e-9)
    assert (true - rows[3].mean()) / RAD_S_PER_COUNT == pytest.approx(-0.5, abs=0.25)


def test_top_speed_at_11_volts(robot_wire):
    bench = robot_wire()
    for servo_id in range(1, 9):
        client = Client(bench, servo_id)
        client.put("velocity_limit", 400)
        client.put("torque_enable", 1)
    drive_all(bench, 400)
    Client(bench).wait(2.0)
    assert watch(bench, 0.5)[1].mean() == pytest.approx(4.9, abs=0.1)


def test_resting_and_holding_servos_dither_by_a_count_or_so(robot_wire):
    bench = robot_wire()
    for servo_id in range(1, 9):
        Client(bench, servo_id).put("torque_enable", 1)
    shown = watch(bench, 1.0)[4]
    assert np.ptp(shown) <= 3


def test_the_recorded_cadence_as_an_option(wire):
    bench = wire(cadence_s=0.016, seed=2)
    bench.world.plant.velocity[:] = 2.0
    client = Client(bench)
    client.put("torque_enable", 1)
    client.put("goal_velocity", 120)
    client.wait(0.2)
    renewed, last = [], None
    for _ in range(24_000):
        bench.world.advance_to(bench.world.now_ns + 500_000)
        bench.world.sync_plant()
        counts = show(bench)[2]
        if counts != last:
            last = counts
            renewed.append(bench.world.now_ns)
    periods_ms = np.diff(renewed) * 1e-6
    assert np.median(periods_ms) == pytest.approx(16.0, abs=0.01)
    assert periods_ms.mean() == pytest.approx(16.0, abs=0.02)
    assert 0.3 < periods_ms.std() < 1.0
    assert 1 <= np.count_nonzero(periods_ms > 19.5) <= 15
    assert periods_ms.max() <= 30.0


def test_velocities_and_angles_through_the_driver_are_si(servo_bench):
    bench = servo_bench()
    bench.driver.enable()
    start = bench.driver.read()[0].position_rad
    began = bench.clock.now_ns()
    for k in range(200):
        bench.driver.read()
        bench.driver.command(ServoSetpoint(np.array([1.0, -2.0, 3.0, 0.5]), np.array([0.5, -1.0, 2.0, 0.0])))
        bench.clock.sleep_until_ns(began + (k + 1) * 10_000_000)
    (sample,) = bench.driver.read()
    lsb = RAD_S_PER_COUNT
    assert np.all(np.abs(sample.velocity_rad_s[:4] - [1.0, -2.0, 3.0, 0.5]) < 1.6 * lsb)
    expected = np.array([1.0, -2.0, 3.0, 0.5]) * (2.0 - 0.033)
    np.testing.assert_allclose(sample.position_rad[:4] - start[:4], expected, atol=0.06)
    np.testing.assert_allclose(sample.position_rad[4:], [0.5, -1.0, 2.0, 0.0], atol=3 * RAD_PER_COUNT)
    np.testing.assert_allclose(sample.current_a[:4], [0.05, -0.05, 0.05, 0.05], atol=0.003)
    assert math.isclose(start[4], 0.0, abs_tol=2 * RAD_PER_COUNT)
