"""The one rule of what becomes of a message, and that every wire draws once for each message."""

from itertools import pairwise

import can
import numpy as np
import pytest

from hil.core.errors import UsageError
from hil.fakes.can_channel import CanChannel
from hil.fakes.world import World
from hil.faults.fault import IN, OUT, parse_fault
from hil.faults.messages import FRAME_FAULTS, STREAM_FAULTS, Messages
from hil.faults.plan import FaultPlan
from tests.still_plant import StillPlant

SECOND = 10**9
SENT = bytes(range(60))


def messages(*faults, kinds=STREAM_FAULTS, seed=1, **options):
    plan = FaultPlan(map(parse_fault, faults))
    return Messages(plan, ("device", "device.1"), np.random.default_rng(seed), kinds, **options)


def arrived(rule, way=IN, count=2000):
    return [rule.received(SENT, 0, way) for _ in range(count)]


@pytest.mark.parametrize("probability", [0.02, 0.2, 0.9])
@pytest.mark.parametrize("kind", ["drop", "duplicate", "corrupt", "truncate"])
def test_a_fault_strikes_its_share_of_the_messages(kind, probability):
    found = arrived(messages(f"device.1:{kind},probability={probability}"))
    struck = np.mean([one != (SENT,) for one in found])
    assert struck == pytest.approx(probability, abs=4 * np.sqrt(probability * (1 - probability) / 2000))


def test_each_fault_does_to_a_message_what_it_says():
    bits = {
        int.from_bytes(SENT, "big") ^ int.from_bytes(one, "big")
        for (one,) in arrived(messages("device:corrupt,probability=1"))
    }
    assert bits <= {1 << k for k in range(8 * len(SENT))}
    assert len(bits) > 0.95 * 8 * len(SENT)
    cut = [one for (one,) in arrived(messages("device:truncate,probability=1"))]
    assert all(SENT.startswith(one) for one in cut)
    assert {len(one) for one in cut} == set(range(len(SENT)))
    assert set(arrived(messages("device:duplicate,probability=1"))) == {(SENT, SENT)}
    assert set(arrived(messages("device:silent"))) == {()}
    assert {len(one) for (one,) in arrived(messages("device:garbage"))} == {len(SENT)}


def test_a_fault_acts_on_its_way_and_while_it_is_active():
    for given, ways in (("", {IN}), (",direction=in", {IN}), (",direction=out", {OUT})):
        rule = messages(f"device:silent@1+1{given}")
        assert {way for way in (IN, OUT) if not rule.received(SENT, SECOND, way)} == ways
        assert rule.received(SENT, 0) == rule.received(SENT, 2 * SECOND) == (SENT,)
    both = messages("device:silent,direction=both")
    assert both.received(SENT, 0, IN) == both.received(SENT, 0, OUT) == ()
    mute = messages("device:silent", way=OUT)
    assert (mute.received(SENT, 0, IN), mute.received(SENT, 0, OUT)) == ((SENT,), ())
    with pytest.raises(UsageError, match="one of in, out, both"):
        parse_fault("device:silent,direction=up")


def test_what_a_device_does_itself_is_left_to_it():
    rule = messages("device:garbage", "device:silent", kinds=FRAME_FAULTS)
    rule.leave_out({"silent"})
    rule.leave_out({"garbage"})
    assert rule.received(SENT, 0) == (SENT,)


def test_pieces_are_the_message_and_leave_pauses():
    rule = messages("device:pieces,size=7,gap_s=0.003")
    sizes = []
    for _ in range(500):
        pauses, pieces = zip(*rule.pieces(SENT, 0), strict=True)
        assert b"".join(pieces) == SENT
        assert pauses == (0, *[3_000_000] * (len(pieces) - 1))
        sizes += map(len, pieces[:-1])
    assert np.mean(sizes) == pytest.approx(7, rel=0.03)
    assert list(rule.pieces(b"", 0)) == []


def wait(bus, world, until_ns):
    """Frames that a client gets until a world time: arrival in s, and first byte."""
    found = []
    while world.now_ns < until_ns:
        frame = bus.recv((until_ns - world.now_ns) / SECOND)
        if frame is not None:
            found.append((frame.timestamp, frame.data[0]))
    return found


class Chatter:
    """A part of the world that sends a numbered frame every 10 ms, each later by the delay that is given."""

    announces = alone = broken = False

    def __init__(self, world, channel):
        self._channel, self._due_ns, self._number, self.delay_ns = channel, 0, 0, 0
        world.add(self)

    def next_due_ns(self):
        return self._due_ns

    def on_due(self, t_ns):
        self._channel.transmit(1, bytes([self._number]), t_ns + self.delay_ns)
        self._number, self._due_ns = self._number + 1, t_ns + SECOND // 100


def test_a_delay_of_reports_delays_no_command_and_keeps_their_order():
    """`adhesion:delayed` of 0.1 s once held up the commands as well."""
    world = World(StillPlant(), faults=FaultPlan([parse_fault("adhesion:delayed")]))
    channel = CanChannel(world, device="adhesion").open()
    chatter = Chatter(world, channel)
    client, other = (can.Bus(interface="hil", channel="hil") for _ in range(2))
    try:
        chatter.delay_ns = SECOND // 10
        assert wait(client, world, SECOND // 20) == []
        client.send(can.Message(arbitration_id=9, data=[99]))
        assert [byte for _, byte in wait(other, world, world.now_ns + SECOND // 1000)] == [99]
        chatter.delay_ns = 0
        reports = wait(client, world, SECOND // 4)
    finally:
        client.shutdown()
        other.shutdown()
        channel.close()
    assert [byte for _, byte in reports] == list(range(len(reports)))
    assert reports[0][0] == pytest.approx(0.1, abs=0.001)
    assert all(before[0] < after[0] for before, after in pairwise(reports))
    assert reports[-1][0] == pytest.approx(0.24, abs=0.001)
