"""Which packets of a MAVLink sender are lost: as many as were truly dropped, whoever shares the counter."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.drivers.tracker.mavlink.packet_losses import PacketLosses


def counted(packets):
    """What is counted of (number, whether it is ours), in the order in which they come."""
    losses = PacketLosses()
    for number, ours in packets:
        (losses.count if ours else losses.count_other)(number % 256)
    return losses.lost


def sent(count, *, shared, every=3):
    """(number, ours): ours, and those of another component by one counter for both, or one for each."""
    numbers = {True: 0, False: 77}
    for k in range(count):
        ours = k % every != 0
        if shared:
            yield k, ours
        else:
            numbers[ours] += 1
            yield numbers[ours], ours


@pytest.mark.parametrize("shared", [True, False])
def test_nothing_is_lost_where_everything_comes(shared):
    assert counted(sent(2000, shared=shared)) == 0


@given(st.integers(0, 10_000))
def test_exchanged_datagrams_are_no_losses(seed):
    rng = random.Random(seed)
    packets = list(sent(1500, shared=True))
    for k in range(1, len(packets) - 8, 9):
        late = packets.pop(k)
        packets.insert(k + rng.randint(1, 6), late)
    assert counted([(0, True), *packets]) <= 1, "the very first may be late for ever"


@given(st.integers(0, 10_000))
def test_dropped_packets_of_both_components_are_counted_once(seed):
    """By one counter nobody knows whose packet a missing one was."""
    rng = random.Random(seed)
    packets = list(sent(1500, shared=True))
    first, *rest = packets[1:-2]
    kept = [packet for packet in rest if rng.random() > 0.05]
    kept += packets[-2:]
    assert counted([first, *kept]) == len(rest) + 2 - len(kept)


def test_a_restarted_sender_and_a_repeated_packet_lose_nothing():
    assert counted([(k, True) for k in (*range(200, 256), *range(0, 40), 39, 39, 40)]) == 0
    assert counted([(k, True) for k in (*range(100), *range(120))]) == 0


def test_a_gap_counts():
    assert counted([(k, True) for k in (*range(10), *range(13, 20), *range(25, 30))]) == 8
