"""Errors of the servos' angles, recovered from what the registers show of a wheel that turns evenly."""

import struct

import numpy as np
import pytest
from servo_client import ALL, RAD_PER_COUNT, SYNC_WRITE, Client, word

from hil.drivers.servos.dynamixel.packets import find_statuses, instruction
from hil.fakes.servos.dynamixel.true_parameters import ServoBusOptions
from hil.fakes.smooth_noise import SmoothNoise

PERIOD_NS = 16_000_000
RATE_RAD_S = 2.0


def shown(bench, duration_s):
    """Positions (n, 8) and velocities (n, 8), counts, every 16 ms."""
    rows, world = [], bench.world
    for _ in range(round(duration_s * 1e9 / PERIOD_NS)):
        world.advance_to(world.now_ns + PERIOD_NS)
        world.sync_plant()
        row = []
        for servo_id in range(1, 9):
            request = instruction(servo_id, 2, word(126) + word(10))
            (reply,) = bench.bus.receive(request, world.now_ns, bench.baud)
            row.append(struct.unpack("<hii", find_statuses(reply.data)[0][1].data)[1:])
        rows.append(row)
    velocity, position = np.array(rows, dtype=float).transpose(2, 0, 1)
    return position, velocity


def turning(wire, duration_s=30.0, **options):
    """What the registers show of drives at one rate; true angles of a drive, rad."""
    bench = wire(**options)
    for servo_id in range(1, 9):
        Client(bench, servo_id).put("torque_enable", 1)
    goal = round(RATE_RAD_S / 0.0239808).to_bytes(4, "little", signed=True)
    parts = b"".join(bytes((servo_id,)) + goal for servo_id in range(1, 5))
    bench.send(instruction(ALL, SYNC_WRITE, word(104) + word(4) + parts))
    shown(bench, 2.0)
    return shown(bench, duration_s)


def about_a_line(values):
    t = np.linspace(-1.0, 1.0, len(values))
    return values - np.polynomial.polynomial.polyval(t, np.polynomial.polynomial.polyfit(t, values, 1)).T


def lag_one(values):
    return np.sum(values[1:] * values[:-1], axis=0) / np.sum(values**2, axis=0)


def test_ripple_has_its_amplitude_and_phase_at_each_order_of_the_wheels_angle(wire):
    amplitude, phase = ((4.0, 1.5), (0.0, 2.0), (), (5.5,)), ((0.5, -2.0), (0.0, 1.0), (), ())
    position, _ = turning(wire, ripple_counts=amplitude, ripple_phase_rad=phase)
    start = np.array([*ServoBusOptions().drive_start_counts])
    for drive in range(4):
        angle = (position[:, drive] - start[drive]) * RAD_PER_COUNT
        columns = [f(k * angle) for k in (1, 2) for f in (np.sin, np.cos)]
        table = np.column_stack([*columns, np.ones_like(angle), np.arange(len(angle))])
        found = np.linalg.lstsq(table, position[:, drive], rcond=None)[0][:4].reshape(2, 2)
        for order in range(2):
            true, at = ((*row[drive], 0.0, 0.0)[order] for row in (amplitude, phase))
            wanted = true * np.array([np.cos(at), np.sin(at)])
            np.testing.assert_allclose(found[order], wanted, atol=0.1)


def test_a_velocity_of_finer_angles_follows_ripple_and_wander_and_shows_no_rounding_of_counts(wire):
    moved = {"ripple_counts": ((4.0,),) * 4, "wander_counts": 1.3}
    coarse, fine = (
        about_a_line(turning(wire, velocity_from=of, **moved)[1][:, :4]) for of in ("counts", "angle")
    )
    assert np.all(lag_one(fine) > lag_one(coarse) + 0.1)
    assert np.mean(lag_one(fine)) == pytest.approx(0.89, abs=0.04)
    assert np.all(
        np.abs(np.diff(fine, axis=0)).mean(axis=0) < 0.6 * np.abs(np.diff(coarse, axis=0)).mean(axis=0)
    )


def test_wander_and_dither_have_their_size_under_way_and_stay_at_rest(wire):
    bench = wire(wander_counts=3.0, steer_dither_counts=2.0, wander_s=0.1, steer_dither_s=0.1)
    for servo_id in range(1, 9):
        Client(bench, servo_id).put("torque_enable", 1)
    shown(bench, 1.0)  # to the angle that the register showed when torque was switched on
    assert np.all(np.std(shown(bench, 5.0)[0], axis=0) < 0.65)
    position, _ = turning(
        wire, 60.0, wander_counts=3.0, steer_dither_counts=2.0, wander_s=0.1, steer_dither_s=0.1
    )
    size = np.std(about_a_line(position), axis=0)
    rounded = 1 / 12 + 0.25**2
    assert size[:4] == pytest.approx(np.sqrt(9.0 + rounded), rel=0.12)
    assert size[4:] == pytest.approx(np.sqrt(4.0 + rounded), rel=0.12)


def test_smooth_noise_is_correlated_as_two_low_passes():
    noise = SmoothNoise(np.random.default_rng(3), 400, 0.05, 0.01)
    values = np.array([noise.step() for _ in range(3000)])
    assert np.std(values) == pytest.approx(1.0, abs=0.02)
    for lag in (5, 10):
        x = lag * 0.01 / 0.05
        found = np.mean(values[lag:] * values[:-lag])
        assert found == pytest.approx((1.0 + x) * np.exp(-x), abs=0.03)
