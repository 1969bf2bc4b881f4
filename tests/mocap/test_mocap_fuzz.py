"""Whatever datagrams arrive, the capture driver gives samples or an error of ours, in bounded time."""

import contextlib

import natnet_builder as build
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.config.mocap import MocapConfig
from hil.core.errors import DeviceError
from hil.core.signals import Status
from hil.drivers.mocap.natnet.driver import NatNetMocap
from hil.fakes.world import VirtualClock, World
from hil.links.udp_ports import Datagram
from tests.selected import draws

SERVER = ("127.0.0.1", 1510)
FLOATS = st.floats(allow_nan=True, allow_infinity=True)
SINGLES = st.floats(allow_nan=True, allow_infinity=True, width=32)
TICKS = st.integers(0, 2**64 - 1)
SENDERS = st.sampled_from([SERVER, ("127.0.0.1", 1511), ("10.1.2.3", 1510), ("127.0.0.1", 0)])


class Standing:
    """A plant that is not observed."""

    t_ns = 0

    def advance(self, t_ns):
        self.t_ns = t_ns


class Posted:
    """Datagram ports fed by a test; a connect and a model request are answered truthfully."""

    def __init__(self, clock, info):
        self.clock, self.info, self.queue = clock, info, []

    def __call__(self, group, port):
        return self

    def put(self, data, sender=SERVER):
        self.queue.append(Datagram(data, sender, self.clock.now_ns()))

    def send(self, data, address):
        if data[0] == 0:
            self.put(build.server_info(**self.info))
            self.put(build.frame((4, 1), 5, [build.body(1)]))
        elif data[0] == 4:
            self.put(build.models((4, 1), (1, build.body_model((4, 1), "robot", 1))))

    def receive(self):
        return self.queue.pop(0) if self.queue else None

    def close(self):
        self.queue.clear()


def opened(**info):
    """(ports, driver, clock) after a sound handshake."""
    clock = VirtualClock(World(Standing()))
    ports = Posted(clock, info)
    driver = NatNetMocap(MocapConfig(fail_after_s=1.0), clock, datagrams=ports)
    driver.open()
    return ports, driver, clock


def checked(driver):
    """The samples of one read, none of which is a number where it is not usable."""
    samples = driver.read()
    for s in samples:
        if s.status is Status.OK:
            assert np.isfinite(s.position_m).all()
            assert np.isfinite(s.quaternion_wxyz).all()
        assert -(2**63) < s.stamp.t_ns <= s.stamp.host_ns + 100
        assert -(2**63) < s.stamp.device_ns < 2**63
    return samples


FRAMES = st.builds(
    lambda number, position, rotation, error, flags, suffix, changed: build.frame(
        (4, 1), number, [build.body(1, position, rotation, error, flags)], suffix=suffix, flags=changed
    ),
    st.integers(-(2**31), 2**31 - 1),
    st.tuples(SINGLES, SINGLES, SINGLES),
    st.tuples(SINGLES, SINGLES, SINGLES, SINGLES) | st.just((0.0, 0.0, 0.0, 1.0)),
    SINGLES,
    st.integers(-(2**15), 2**15 - 1),
    st.tuples(st.just(0), st.just(0), FLOATS, TICKS, TICKS, TICKS),
    st.integers(0, 3),
)
OTHERS = st.one_of(
    st.binary(max_size=200),
    st.builds(build.message, st.integers(0, 120), st.binary(max_size=100)),
    st.builds(
        build.server_info,
        st.tuples(st.integers(0, 5), st.integers(0, 9)),
        clock_hz=TICKS,
        data_port=st.integers(0, 65535),
    ),
)


@draws(80)
@given(
    packets=st.lists(st.tuples(FRAMES | OTHERS, SENDERS, st.integers(0, 400_000_000)), max_size=12),
    clock_hz=TICKS,
)
def test_frames_of_any_content_give_samples_or_a_device_error(packets, clock_hz):
    ports, driver, clock = opened(clock_hz=clock_hz)
    for data, sender, pause_ns in packets:
        ports.put(data, sender)
        clock.sleep_until_ns(clock.now_ns() + pause_ns)
        with contextlib.suppress(DeviceError):
            checked(driver)
    driver.close()


@draws(40)
@given(answers=st.lists(OTHERS | FRAMES, max_size=6))
def test_a_server_that_talks_nonsense_cannot_be_opened(answers):
    clock = VirtualClock(World(Standing()))

    class Nonsense(Posted):
        def send(self, data, address):
            for answer in answers:
                self.put(answer)

    driver = NatNetMocap(MocapConfig(open_timeout_s=0.5), clock, datagrams=Nonsense(clock, {}))
    with pytest.raises(DeviceError):
        driver.open()
    assert clock.now_ns() < 2_000_000_000


@pytest.mark.parametrize("timestamp_s", [-1e300, float("inf"), float("nan")])
def test_a_time_stamp_beyond_all_measure_is_stale(timestamp_s):
    ports, driver, _ = opened(clock_hz=0)
    ports.put(build.frame((4, 1), 6, [build.body(1)], suffix=(0, 0, timestamp_s, 0, 0, 0)))
    (sample,) = checked(driver)
    assert sample.status is Status.STALE
