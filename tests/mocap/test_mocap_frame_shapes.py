"""A frame of the shape of the one before it is taken apart in one step, with what `parse_frame` finds."""

import contextlib

import natnet_builder as build
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.drivers.mocap.natnet.messages import FrameParser, parse_frame
from hil.drivers.mocap.natnet.packets import MalformedPacket

ID = 7
BODIES = st.permutations([ID, 8, 9]).flatmap(
    lambda ids: st.integers(1, 3).map(lambda count: [build.body(i) for i in ids[:count]])
)
VERSIONS = st.sampled_from([(3, 1), (4, 0), (4, 1)])
DAMAGE = st.none() | st.tuples(st.integers(0, 400), st.integers(1, 255))


def outcome(parse, payload):
    """What comes of a payload: all figures of a frame, NaN too, or that it is malformed."""
    with contextlib.suppress(MalformedPacket):
        return repr(parse(payload))
    return "malformed"


@given(VERSIONS, st.lists(st.tuples(BODIES, DAMAGE), min_size=2, max_size=12))
@settings(deadline=None)
def test_shapes_change_nothing_that_is_found(version, frames):
    parser = FrameParser(version, ID)
    for number, (bodies, damage) in enumerate(frames):
        payload = bytearray(build.frame(version, number, bodies)[4:])
        if damage is not None:
            payload[damage[0] % len(payload)] ^= damage[1]
        payload = bytes(payload)
        assert outcome(parser.parse, payload) == outcome(lambda p: parse_frame(p, version, ID), payload)
