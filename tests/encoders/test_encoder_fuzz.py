"""Whatever frames are on the CAN bus, the encoder driver gives samples or an error of ours."""

import contextlib

import can
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from still_plant import StillPlant

from hil.config.encoders import EncodersConfig
from hil.core.errors import DeviceError
from hil.core.signals import Status
from hil.drivers.encoders.as5045.driver import As5045Encoders
from hil.fakes.can_channel import CanChannel
from hil.fakes.encoders.as5045.chip import EncoderNode
from hil.fakes.world import VirtualClock, World
from hil.links.can_interface import OpenBus
from tests.selected import draws

OURS = st.sampled_from([416, 417])


def frame(identifier, data, extended, remote, error):
    return can.Message(
        arbitration_id=identifier,
        data=b"" if remote else data,
        dlc=len(data),
        is_extended_id=extended or identifier > 0x7FF,
        is_remote_frame=remote and not error,
        is_error_frame=error,
    )


FRAMES = st.builds(
    frame,
    OURS | st.integers(0, 0x1FFFFFFF),
    st.binary(max_size=8),
    st.booleans(),
    st.sampled_from([False, False, False, True]),
    st.sampled_from([False, False, False, True]),
)


@draws(60)
@given(frames=st.lists(st.tuples(FRAMES, st.integers(0, 60_000_000)), max_size=30), with_node=st.booleans())
def test_any_frames_give_samples_or_a_device_error(frames, with_node):
    world = World(StillPlant(), seed=1)
    channel = CanChannel(world, "fuzz").open()
    if with_node:
        EncoderNode(world, channel)
    clock = VirtualClock(world)
    config = EncodersConfig(interface="hil", channel="fuzz", fail_after_s=1.0, open_timeout_s=0.2)
    driver = As5045Encoders(config, clock)
    try:
        with contextlib.suppress(DeviceError):
            driver.open()
            for message, pause_ns in frames:
                channel.send(message, world.now_ns)
                clock.sleep_until_ns(clock.now_ns() + pause_ns)
                for sample in driver.read():
                    for angle, status in zip(sample.angle_rad, sample.status, strict=True):
                        assert np.isfinite(angle) == (status is Status.OK)
                        assert not np.isfinite(angle) or -np.pi <= angle < np.pi
        assert clock.now_ns() < 10_000_000_000
    finally:
        driver.close()
        channel.close()


class Flood:
    """A bus on which there is always one more frame."""

    def __init__(self, *messages):
        self.messages, self.taken = messages, 0

    def recv(self, timeout):
        self.taken += 1
        message = self.messages[self.taken % len(self.messages)]
        if isinstance(message, Exception):
            raise message
        return message

    def shutdown(self):
        pass


@pytest.mark.parametrize(
    ("messages", "most"),
    [
        ([frame(7, b"1234", False, False, False)], 512),
        ([frame(416, b"1", False, False, False)], 512),
        ([frame(416, b"12345678", False, False, False)], 512),
        ([frame(416, bytes((k,)) * 8, False, False, False) for k in range(256)], 512),
        ([can.CanOperationError("could not unpack received message")], 32),
    ],
    ids=["others", "malformed", "half a set", "made up", "junk"],
)
def test_a_flood_of_frames_costs_a_bounded_piece_of_every_read(encoder_bench, messages, most):
    bench = encoder_bench()
    bench.driver.open()
    bench.driver._link._bus.shut()
    for _ in range(3):
        flood = Flood(*messages)
        bench.driver._link._bus = OpenBus(flood)
        bench.driver.read()
        assert 0 < flood.taken <= most
