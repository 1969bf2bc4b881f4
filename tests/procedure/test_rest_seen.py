"""A rest is watched on while motion capture does not see its end, as long as the device may be silent."""

import numpy as np
import pytest

import hil
from hil.core.errors import DataError, DeviceTimeoutError
from hil.procedure.tracking_errors import moved_at_rest, watched_to_a_seen_end


def rest(gap_s):
    with hil.open_bench("emulated_floor", seed=1, faults=[f"mocap:off@6+{gap_s}"]) as bench:
        first = bench.observe(6.8 - 1e-9 * bench.clock.now_ns(), feedback="odometry")
        return first, watched_to_a_seen_end(bench, first)


def test_a_short_gap_at_the_end_is_waited_for():
    first, watched = rest(0.9)
    with pytest.raises(DataError, match="not at its end"):
        moved_at_rest(first)
    assert moved_at_rest(watched) < 1e-3
    assert np.all(np.diff(watched.t_s) > 0.0)


def test_after_a_long_gap_it_is_the_devices_error():
    with pytest.raises(DeviceTimeoutError, match="mocap"):
        rest(60.0)
