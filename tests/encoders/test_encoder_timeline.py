"""Node time on the bench clock: late arrivals are found out, and times never go back."""

import numpy as np
import pytest

from hil.drivers.encoders.as5045.node_status import NodeTimeline
from hil.links.can_arrival_times import ArrivalClock

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


OFFSET_NS = 700_000_000_000
FRAME_NS = 5_000_000


def drain(clock, timeline, first, count, now_ns, step_ns=0):
    """Frames `first` and on of a node that samples every 5 ms, drained at `now_ns` from an interface whose
    clock is OFFSET_NS (and `step_ns`) ahead; their errors in time, and whether the node has restarted."""
    errors, restarts = [], []
    for k in range(first, first + count):
        sampled_ns = k * FRAME_NS
        arrival_ns = clock.arrival_ns((sampled_ns + OFFSET_NS + step_ns) / 1e9, now_ns)
        t_ns, _, restarted = timeline.update(k & 0xFF, sampled_ns // 10_000 & 0xFFFFF, arrival_ns)
        errors.append(t_ns - sampled_ns)
        restarts.append(restarted)
    return errors, restarts


@pytest.mark.parametrize("kept", [600, 120])
def test_frames_that_were_not_drained_for_seconds_are_no_restart(kept):
    """All of them were kept, or what did not fit into the interface's buffer was lost."""
    clock, timeline = ArrivalClock(), NodeTimeline(0xFF, 0xFFFFF, 1e-5)
    for k in range(100):
        drain(clock, timeline, k, 1, k * FRAME_NS + 100_000)
    errors, restarts = drain(clock, timeline, 100, kept, 700 * FRAME_NS + 100_000)
    later, again = drain(clock, timeline, 701, 2, 702 * FRAME_NS + 100_000)
    assert not any(restarts + again)
    assert max(map(abs, errors + later)) < 300_000


def test_a_true_restart_is_reported_even_out_of_a_pile_of_frames():
    clock, timeline = ArrivalClock(), NodeTimeline(0xFF, 0xFFFFF, 1e-5)
    for k in range(100):
        drain(clock, timeline, k, 1, k * FRAME_NS)
    reported = []
    for k in range(400):
        sampled_ns = (150 + k) * FRAME_NS
        arrival_ns = clock.arrival_ns((sampled_ns + OFFSET_NS) / 1e9, 700 * FRAME_NS)
        reported.append(timeline.update(k & 0xFF, k * FRAME_NS // 10_000, arrival_ns)[2])
    assert reported == [True] + [False] * 399


@pytest.mark.parametrize("step_ns", [-3_000_000_000, 3_000_000_000])
@pytest.mark.parametrize("silence", [0, 1000])
def test_the_interfaces_clock_may_be_set_while_it_runs(step_ns, silence):
    clock, timeline = ArrivalClock(), NodeTimeline(0xFF, 0xFFFFF, 1e-5)
    for k in range(100):
        drain(clock, timeline, k, 1, k * FRAME_NS)
    errors = []
    for k in range(100 + silence, 400 + silence):
        errors += drain(clock, timeline, k, 1, k * FRAME_NS, step_ns)[0]
    assert max(map(abs, errors[100:])) < 300_000
