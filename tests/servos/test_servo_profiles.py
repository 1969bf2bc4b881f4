"""Profiles of goals: shapes, durations and status, by the laws of the vendor's profile section."""

import numpy as np
import pytest
from hypothesis import Phase, example, given
from hypothesis import strategies as st
from servo_client import MODEL, RAD_PER_COUNT, RAD_S_PER_COUNT, TABLE, Client

from hil.fakes.servos.dynamixel.motor_command import RECTANGLE, STEP, TRAPEZOID, TRIANGLE, Trajectory
from tests.selected import draws

DT_S = 0.004
SPEED_COUNTS_S = RAD_S_PER_COUNT / RAD_PER_COUNT
SLOPE_COUNTS_S2 = TABLE["profile_acceleration"].scale / RAD_PER_COUNT


def follow(trajectory, most_s=60.0):
    """Positions and speeds at every grid step until the trajectory has arrived."""
    positions, speeds = [trajectory.position], [trajectory.speed]
    while trajectory.ongoing and len(positions) * DT_S < most_s:
        trajectory.advance(DT_S)
        positions.append(trajectory.position)
        speeds.append(trajectory.speed)
    return np.array(positions), np.array(speeds)


def resting(position=0.0):
    trajectory = Trajectory(MODEL)
    trajectory.rest(position)
    return trajectory


def test_without_a_profile_a_goal_is_a_step():
    trajectory = resting(100.0)
    trajectory.move(900, 50, 0, timed=False)
    assert (trajectory.position, trajectory.shape, trajectory.ongoing) == (900.0, STEP, False)
    trajectory.move(900, 0, 40, timed=False)
    assert not trajectory.ongoing


def test_without_acceleration_the_profile_is_a_rectangle():
    trajectory = resting()
    trajectory.move(-1000, 0, 50, timed=False)
    assert trajectory.shape == RECTANGLE
    positions, _ = follow(trajectory)
    assert np.diff(positions)[:-1] == pytest.approx(-50 * SPEED_COUNTS_S * DT_S)
    assert len(positions) * DT_S == pytest.approx(1000 / (50 * SPEED_COUNTS_S), abs=2 * DT_S)


@pytest.mark.parametrize("goal", [4000, -4000])
def test_a_long_way_is_a_trapezoid(goal):
    trajectory = resting()
    trajectory.move(goal, 10, 100, timed=False)
    assert trajectory.shape == TRAPEZOID
    positions, speeds = follow(trajectory)
    top, slope = 100 * SPEED_COUNTS_S, 10 * SLOPE_COUNTS_S2
    assert max(abs(speeds)) == pytest.approx(top)
    assert max(abs(np.diff(speeds[:-1]))) <= slope * DT_S * (1 + 1e-9)
    assert len(positions) * DT_S == pytest.approx(4000 / top + top / slope, abs=4 * DT_S)
    assert trajectory.position == goal


def test_a_short_way_is_a_triangle():
    trajectory = resting()
    trajectory.move(100, 5, 200, timed=False)
    assert trajectory.shape == TRIANGLE
    positions, speeds = follow(trajectory)
    slope = 5 * SLOPE_COUNTS_S2
    assert max(speeds) == pytest.approx((100 * slope) ** 0.5, rel=0.05)
    assert len(positions) * DT_S == pytest.approx(2 * (100 / slope) ** 0.5, abs=4 * DT_S)


@pytest.mark.parametrize(
    ("total_ms", "rise_ms"), [(1000, 0), (1000, 250), (1000, 500), (1000, 900), (400, 100)]
)
def test_a_time_based_profile_takes_its_time(total_ms, rise_ms):
    trajectory = resting()
    trajectory.move(2000, rise_ms, total_ms, timed=True)
    positions, speeds = follow(trajectory)
    assert len(positions) * DT_S == pytest.approx(total_ms * 1e-3, abs=5 * DT_S)
    rise_s = min(rise_ms, total_ms // 2) * 1e-3
    assert max(speeds[:-1]) == pytest.approx(2000 / (total_ms * 1e-3 - rise_s), rel=0.05)


@pytest.mark.parametrize(("velocity", "acceleration"), [(100, 5), (-200, 20), (40, 1)])
def test_a_velocity_ramp_takes_64_v_over_a_milliseconds(velocity, acceleration):
    """e-manual: t1 = 64 * Goal Velocity / Profile Acceleration."""
    trajectory = resting()
    trajectory.turn(velocity, acceleration, timed=False)
    steps = 0
    while trajectory.ongoing:
        trajectory.advance(DT_S)
        steps += 1
    assert trajectory.velocity == velocity
    assert steps * DT_S == pytest.approx(64e-3 * abs(velocity) / acceleration, rel=0.002, abs=1.5 * DT_S)


def test_a_time_based_velocity_ramp_takes_its_time():
    trajectory = resting()
    trajectory.turn(150, 200, timed=True)
    for _ in range(25):
        trajectory.advance(DT_S)
    assert trajectory.velocity == pytest.approx(75)
    for _ in range(25):
        trajectory.advance(DT_S)
    assert (trajectory.velocity, trajectory.ongoing) == (150, False)
    trajectory.turn(150, 200, timed=True)
    assert not trajectory.ongoing


GOALS = st.tuples(
    st.integers(-5000, 5000),
    st.just(0) | st.integers(50, 300),
    st.just(0) | st.integers(50, 400),
    st.booleans(),
    st.integers(0, 60),
)


@draws(100, phases=(Phase.explicit, Phase.generate))
@example(moves=[(1954, 0, 75, True, 7), (703, 213, 233, True, 39)])
@given(moves=st.lists(GOALS, min_size=1, max_size=4))
def test_every_chain_of_goals_ends_at_the_last_one(moves):
    trajectory = resting()
    for goal, acceleration, velocity, timed, steps in moves:
        trajectory.move(goal, acceleration, velocity, timed=timed)
        for _ in range(steps):
            if trajectory.ongoing:
                trajectory.advance(DT_S)
    follow(trajectory, most_s=400.0)
    assert trajectory.position == moves[-1][0]
    assert (trajectory.speed, trajectory.ongoing) == (0.0, False)


def test_the_registers_show_the_profile(wire):
    client = Client(wire(), 5)
    client.put("torque_enable", 1)
    client.put("profile_velocity", 60)
    client.put("profile_acceleration", 8)
    client.put("goal_position", 3000)
    client.wait(0.4)
    assert client.get("moving") == 1
    assert client.get("moving_status") & 0b110010 == 0b110010
    assert 2048 < client.get("position_trajectory") < 3000
    client.wait(0.5)
    assert client.get("present_velocity") == pytest.approx(60, abs=2)
    client.wait(3.0)
    assert (client.get("moving"), client.get("moving_status") & 0b110011) == (0, 1)
    assert client.get("position_trajectory") == 3000
    client.bench.world.plant.position[4] += 0.4
    assert client.get("moving_status") & 0b1000


def test_a_drive_shows_its_ramp_and_no_position_status(wire):
    client = Client(wire())
    client.put("torque_enable", 1)
    client.put("profile_acceleration", 10)
    client.put("goal_velocity", 100)
    client.wait(0.32)
    assert client.get("velocity_trajectory") == pytest.approx(50, abs=3)
    assert (client.get("moving"), client.get("moving_status")) == (1, 0)
    client.wait(0.5)
    assert client.get("velocity_trajectory") == 100
    client.put("drive_mode", 4)
    assert client.get("drive_mode") == 0


def test_time_based_profiles_need_the_bit_and_the_firmware(wire):
    for firmware in (46, 41):
        client = Client(wire(firmware=firmware), 5)
        client.put("drive_mode", 4)
        client.put("torque_enable", 1)
        client.put("profile_velocity", 500)
        began = client.bench.world.now_ns
        client.put("goal_position", 2548)
        while client.get("moving_status") & 2 and client.bench.world.now_ns - began < 2_000_000_000:
            client.wait(0.005)
        took_s = (client.bench.world.now_ns - began) * 1e-9
        assert (0.45 < took_s < 0.6) == (firmware >= 42)
