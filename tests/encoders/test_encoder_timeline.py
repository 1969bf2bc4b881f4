"""Node time on the bench clock: late arrivals are found out, and times never go back."""

import numpy as np
import pytest

from hil.drivers.encoders.timeline import ArrivalClock, NodeTimeline

PERIOD_NS = 5_000_000


def arrived(timeline, k, host_ns):
    return timeline.update(k & 0xFF, k * 50 & 0xFFFF, host_ns)[0]


def test_times_never_go_back_when_late_frames_are_found_out():
    timeline = NodeTimeline(0xFF, 0xFFFF, 1e-4)
    mapped = [arrived(timeline, k, max(k * PERIOD_NS + 100_000, 55_000_000)) for k in range(60)]
    assert np.all(np.diff(mapped) > 0)
    assert mapped[-1] == pytest.approx(59 * PERIOD_NS + 100_000, abs=60_000)


def test_a_frame_without_a_stamp_of_its_interface_arrived_when_it_was_drained():
    clock = ArrivalClock()
    assert clock.arrival_ns(0.0, 123) == 123
    assert clock.arrival_ns(1000.0, 5_000_000) == 5_000_000
    assert clock.arrival_ns(1000.002, 9_000_000) == 7_000_000
    assert clock.arrival_ns(1000.010, 11_000_000) == 11_000_000
