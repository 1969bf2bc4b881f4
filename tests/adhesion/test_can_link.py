"""A CAN bus as drivers have it: the loop finds samples that were made elsewhere, of what says something."""

import threading
import time

import can
import pytest

from hil.config.can_bus import CanConfig
from hil.core.clock import MonotonicClock
from hil.core.errors import DeviceError
from hil.fakes.free_port import free_udp_port
from hil.links.can_bus import CanLink

GROUP = "239.74.164.11"


def meant(made_by):
    """What frames of identifier 7 say; notes who asks."""

    def meaning(t_ns, message, now_ns):
        made_by.add(threading.get_ident())
        assert t_ns <= now_ns
        return bytes(message.data) if message.arbitration_id == 7 else None

    return meaning


def send(bus, *frames):
    for frame_id, data in frames:
        bus.send(can.Message(arbitration_id=frame_id, data=data, is_extended_id=True))


def heard(link, count):
    """So many of what is said, as far as it comes."""
    found, end_s = [], time.monotonic() + 10.0
    while len(found) < count and time.monotonic() < end_s:
        found += link.read_samples()
        time.sleep(0.005)
    return found


@pytest.mark.real_time
def test_in_real_time_a_thread_makes_the_samples_that_the_loop_takes():
    options, made_by = {"port": free_udp_port(), "hop_limit": 0}, set()
    config = CanConfig(interface="udp_multicast", channel=GROUP, options=options)
    link = CanLink("adhesion", config, MonotonicClock())
    link.open()
    try:
        with can.Bus(interface="udp_multicast", channel=GROUP, **options) as bus:
            send(bus, (7, b"before"))
            assert link.take(10.0)
            assert link.read_samples() == []
            link.set_decoder(meant(made_by))
            send(bus, (7, b"first"), (8, b"another"), (7, b"second"))
            assert heard(link, 2) == [b"first", b"second"]
    finally:
        link.close()
    assert made_by
    assert threading.get_ident() not in made_by


@pytest.mark.real_time
def test_a_decoder_that_fails_is_told_and_ends_no_reading():
    def meaning(t_ns, message, now_ns):
        return bytes(message.data)[0]

    options = {"port": free_udp_port(), "hop_limit": 0}
    link = CanLink(
        "adhesion", CanConfig(interface="udp_multicast", channel=GROUP, options=options), MonotonicClock()
    )
    link.open()
    try:
        with can.Bus(interface="udp_multicast", channel=GROUP, **options) as bus:
            link.set_decoder(meaning)
            send(bus, (7, b""))
            with pytest.raises(IndexError):
                heard(link, 1)
            send(bus, (7, b"a"))
            assert heard(link, 1) == [ord("a")]
    finally:
        link.close()


class Jumping(MonotonicClock):
    """A clock that can be put forward, as for a program that was stopped for a while."""

    ahead_ns = 0

    def now_ns(self):
        return super().now_ns() + self.ahead_ns

    def sleep_until_ns(self, t_ns):
        super().sleep_until_ns(t_ns - self.ahead_ns)


@pytest.mark.real_time
def test_a_program_that_stood_still_waits_for_what_had_come_meanwhile():
    options, clock = {"port": free_udp_port(), "hop_limit": 0}, Jumping()
    config = CanConfig(interface="udp_multicast", channel=GROUP, options=options)
    link = CanLink("adhesion", config, clock)
    link.open()
    try:
        with can.Bus(interface="udp_multicast", channel=GROUP, **options) as bus:
            send(bus, (7, b"before"))
            assert link.take(10.0)

            def slow(t_ns, message, now_ns):
                time.sleep(0.02)
                return bytes(message.data)

            link.set_decoder(slow)
            assert link.read_samples() == []
            send(bus, (7, b"later"))
            clock.ahead_ns = 3_000_000_000
            assert link.read_samples() == [b"later"]
    finally:
        link.close()


@pytest.mark.real_time
def test_a_program_that_stood_still_in_its_wait_sees_what_had_come_meanwhile():
    """README's test on devices served for a wall once ended with "no VESC answers" at load 8."""
    options = {"port": free_udp_port(), "hop_limit": 0}
    with can.Bus(interface="udp_multicast", channel=GROUP, **options) as bus:

        class Stopped(Jumping):
            def sleep_until_ns(self, t_ns):
                if not self.ahead_ns:
                    send(bus, (7, b"between"))
                    self.ahead_ns = 3_000_000_000
                super().sleep_until_ns(t_ns)

        config = CanConfig(interface="udp_multicast", channel=GROUP, options=options)
        link = CanLink("adhesion", config, Stopped())
        link.open()
        try:
            assert [bytes(message.data) for _, message in link.take(1.0)] == [b"between"]
        finally:
            link.close()


@pytest.mark.parametrize(
    "groups", [(GROUP, "239.74.164.12"), ("ff15:7079:7468:6f6e:6465::1", "ff15:7079:7468:6f6e:6465::2")]
)
def test_frames_of_another_group_at_the_same_port_are_not_heard(groups):
    options = {"port": free_udp_port(), "hop_limit": 1}
    own, other = (CanConfig(interface="udp_multicast", channel=group, options=options) for group in groups)
    link, stranger = (CanLink("adhesion", config, MonotonicClock()) for config in (own, other))
    try:
        link.open()
        stranger.open()
        stranger.send(7, b"other", extended=True)
        link.send(8, b"own", extended=True)
        assert [message.arbitration_id for _, message in link.take(10.0)] == [8]
    except DeviceError as error:
        pytest.skip(f"no way to such a group here: {error}")
    finally:
        link.close()
        stranger.close()
