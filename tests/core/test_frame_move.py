"""A frame of motion capture that moves is found, and nothing else is taken for one."""

from types import SimpleNamespace

import numpy as np
import pytest

from hil.core.signals import PoseMeasurement, Stamp
from hil.loop.checks.exclusion import Exclusion
from hil.loop.checks.frame_move import FrameMove

EVERY_NS = 10_000_000
RNG = np.random.default_rng(5)


def told(poses, *, estimated=(), every_ns=EVERY_NS, stamps_ns=None):
    """Events of a run with these poses (n, 3), and whether motion capture still counts at its end."""
    excluded = Exclusion(frozenset(estimated), on_wall=True)
    excluded.reset()
    check, events = FrameMove(excluded), []
    for k, pose in enumerate(poses):
        t_ns = k * every_ns if stamps_ns is None else stamps_ns[k]
        seen = PoseMeasurement(Stamp(t_ns, t_ns, k), "mocap", np.asarray(pose, float), 3, True)
        cycle = SimpleNamespace(
            inputs=SimpleNamespace(t_ns=t_ns), measurements=SimpleNamespace(mocap=(seen,)), events=events
        )
        check.on_samples(cycle)
    return events


def climb(n=200, speed_m_s=0.1, sigma_m=0.0003):
    way = np.column_stack([speed_m_s * 0.01 * np.arange(n), np.zeros(n), np.zeros(n)])
    return way + RNG.normal(0.0, sigma_m, (n, 3)) * [1.0, 1.0, 3.0]


@pytest.mark.parametrize(
    "by", [(0.005, 0, 0), (-0.01, 0, 0), (0, 0.1, 0), (0, 0, 0.08), (99.0, 0, 0)], ids=str
)
def test_a_frame_that_moves_is_reported_once_and_counts_for_nothing(by):
    poses = climb()
    poses[100:] += by
    (event,) = told(poses)
    assert (event.source, event.distrusts) == ("mocap", True)
    assert 1.0 < event.t_ns / 1e9 < 1.2
    assert [e.distrusts for e in told(poses, estimated=("mocap",))] == [False], "its filter judges it"


@pytest.mark.parametrize("seed", range(3))
def test_noise_a_stop_a_glitch_and_a_fall_are_no_moved_frame(seed):
    poses = climb(sigma_m=0.0005)
    assert told(poses) == []
    poses[100:, 0] = poses[100, 0]
    assert told(poses) == []
    glitch = climb()
    glitch[50] += (0.05, 0, 0)
    glitch[120:125] += (0, 0.02, 0.1)
    assert told(glitch) == []
    fall = climb()
    t_s = 0.01 * np.arange(100)
    fall[100:, 0] -= 2.5 * t_s**2
    assert told(fall) == []


def test_frames_that_arrive_together_have_no_speed_and_still_show_a_frame_that_moves():
    """A late frame is stamped just after the one before it: their noise, 1 ns apart, is no motion."""
    poses, stamps_ns = climb(), [k * EVERY_NS for k in range(200)]
    for k in range(10, 200, 7):
        stamps_ns[k] = stamps_ns[k - 1] + 1
    assert told(poses, stamps_ns=stamps_ns) == []
    poses[100:] += (0.03, 0, 0)
    (event,) = told(poses, stamps_ns=stamps_ns)
    assert 1.0 < event.t_ns / 1e9 < 1.2


@pytest.mark.parametrize("seed", range(5))
def test_frames_that_are_stamped_late_move_at_even_times_all_the_same(seed):
    """As in the recordings of the real robot: each frame late by another time, none before the one before."""
    late_ns = np.random.default_rng(seed).exponential(15e6, 400)
    stamps_ns = np.maximum.accumulate(np.arange(400) * EVERY_NS + late_ns).astype(int)
    stamps_ns = (stamps_ns + np.arange(400) * 300_000).tolist()
    poses = climb(400)
    assert told(poses, stamps_ns=stamps_ns) == []
    poses[200:] += (0.02, 0, 0)
    (event,) = told(poses, stamps_ns=stamps_ns)
    assert 2.0 < event.t_ns / 1e9 < 2.5
