"""A stopped robot is told from one that slides, whatever the noise of the sensor that sees it."""

import numpy as np
import pytest

from hil.bench.hold.motion_since_stop import Trail

LOOK_NS, PER_LOOK = 20_000_000, 4
THRESHOLD_M = 0.001


def looked_at(rng, sigma_m, speed_m_s, every=1):
    """Whether a robot seems to move once it was seen for long enough, and after how many looks that was.

    The sensor sends a sample at every `every`th look, four samples if it is one.
    """
    trail, place = Trail(THRESHOLD_M), np.zeros(3)
    for look in range(100):
        t_ns = look * LOOK_NS
        for _ in range(PER_LOOK if every == 1 else look % every == 0):
            step_s = LOOK_NS / PER_LOOK / 1e9 if every == 1 else every * LOOK_NS / 1e9
            place = place + np.array([0.0, speed_m_s * step_s, 0.0])
            trail.add(t_ns, place + rng.normal(0.0, sigma_m, 3))
        trail.forget(t_ns - trail.window_ns)
        if trail.full(t_ns):
            return trail.moves(), look
    pytest.fail("the robot was never seen for long enough")


@pytest.mark.parametrize("sigma_m", [0.0, 0.0003, 0.0009, 0.002])
def test_noise_is_no_motion_and_hides_none(sigma_m):
    rng = np.random.default_rng(20)
    at_rest = [looked_at(rng, sigma_m, 0.0) for _ in range(1000)]
    assert sum(moves for moves, _ in at_rest) <= 1
    assert all(moves for moves, _ in (looked_at(rng, sigma_m, 0.012) for _ in range(1000)))


def test_a_sensor_that_delivers_little_is_waited_for_until_its_noise_is_known():
    rng = np.random.default_rng(22)
    at_rest = [looked_at(rng, 0.0005, 0.0, every=2) for _ in range(300)]
    assert sum(moves for moves, _ in at_rest) <= 1
    assert max(look for _, look in at_rest) <= 50
    assert all(looked_at(rng, 0.0005, 0.012, every=2)[0] for _ in range(300))


def test_only_a_noisy_sensor_takes_longer():
    rng = np.random.default_rng(21)
    assert {looked_at(rng, 0.0003, 0.0)[1] for _ in range(100)} == {10}
    assert 15 <= np.mean([looked_at(rng, 0.0009, 0.0)[1] for _ in range(100)]) <= 20


def test_a_garbled_position_neither_moves_the_robot_nor_makes_it_wait():
    trail = Trail(THRESHOLD_M)
    for look in range(11):
        for k in range(PER_LOOK):
            trail.add(look * LOOK_NS, np.full(3, 0.2 if (look, k) == (9, 0) else 0.0))
    assert trail.full(10 * LOOK_NS)
    assert not trail.moves()
