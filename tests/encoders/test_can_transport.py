"""The emulated bus on another python-can interface, as `hil emulate` serves it."""

import contextlib
import threading

import can
import numpy as np
import pytest

from hil.config.encoders import SHIPPED_DBC, EncodersConfig
from hil.core.clock import MonotonicClock
from hil.core.errors import DeviceError, UsageError
from hil.core.signals import Status
from hil.drivers.encoders.as5045.driver import As5045Encoders
from hil.fakes.can_bridge import CanTransport
from hil.fakes.can_channel import CanChannel
from hil.fakes.server import EmulationServer
from hil.fakes.world import NEVER_NS
from hil.links.can_interface import open_bus

pytestmark = pytest.mark.alone

GROUP, PORT = "239.74.163.77", 43177


@contextlib.contextmanager
def serving(server):
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield
    finally:
        server.stop()
        thread.join(10)


def test_third_party_client_hears_the_frames_on_udp_multicast(encoder_bench):
    bench = encoder_bench()
    transport = CanTransport(bench.channel, address=GROUP, dbc=SHIPPED_DBC, options={"port": PORT})
    server = EmulationServer(bench.world, MonotonicClock(), {"can": transport})
    endpoint = server.endpoints()["can"]
    assert (endpoint["interface"], endpoint["channel"], endpoint["dbc"]) == (
        "udp_multicast",
        GROUP,
        str(SHIPPED_DBC),
    )
    with can.Bus(interface="udp_multicast", channel=GROUP, port=PORT, hop_limit=0) as client:
        client.send(can.Message(arbitration_id=1, data=b"hello", is_extended_id=False))
        heard = []
        for _ in range(400):
            server.step()
            while (message := client.recv(0)) is not None:
                heard.append(message)
            if len(heard) > 40:
                break
    server.close()
    ids = [m.arbitration_id for m in heard if m.arbitration_id != 1]
    assert ids[:7] == [416, 417, 418] + [416, 417] * 2
    assert transport.sent >= 40
    assert transport.filenos() == []
    transport.on_readable(0, 0)


def test_a_client_of_another_bit_rate_is_given_both(encoder_bench):
    """Multicast would let it in, a real bus would not."""
    bench = encoder_bench()
    transport = CanTransport(bench.channel, address=GROUP, dbc=SHIPPED_DBC, options={"port": PORT})
    where = {"interface": "udp_multicast", "channel": GROUP, "options": {"port": PORT, "hop_limit": 0}}
    try:
        with pytest.raises(DeviceError, match=r"runs at 500000 bit/s, encoders.bitrate is 250000") as caught:
            As5045Encoders(EncodersConfig(bitrate=250_000, **where), MonotonicClock()).open()
        assert caught.value.exit_code == 3
        assert caught.value.remedy == "set encoders.bitrate = 500000"
        open_bus("encoders", EncodersConfig(**where)).shutdown()
    finally:
        transport.close()
    open_bus("encoders", EncodersConfig(bitrate=250_000, **where)).shutdown()


def test_the_driver_reads_the_served_bus_in_real_time(encoder_bench):
    bench = encoder_bench()
    transport = CanTransport(bench.channel, address=GROUP, options={"port": PORT + 1})
    clock = MonotonicClock()
    driver = As5045Encoders(
        EncodersConfig(interface="udp_multicast", channel=GROUP, options={"port": PORT + 1, "hop_limit": 0}),
        clock,
    )
    with serving(EmulationServer(bench.world, MonotonicClock(), {"can": transport})):
        driver.open()
        clock.sleep_until_ns(clock.now_ns() + 300_000_000)
        samples = driver.read()
        driver.close()
    assert len(samples) > 30
    assert samples[-1].status == (Status.OK,) * 4


def test_an_interface_without_descriptor_and_a_full_one_are_served_too(encoder_bench):
    bench = encoder_bench()
    transport = CanTransport(bench.channel, interface="virtual", address="transport-test")
    with can.Bus(interface="virtual", channel="transport-test", preserve_timestamps=True) as client:
        assert transport.filenos() == []
        bench.world.add(transport)
        bench.clock.sleep_until_ns(50_000_000)
        assert client.recv(0).arbitration_id == 416
    transport.close()
    transport.close()
    bench.clock.sleep_until_ns(100_000_000)
    assert transport.next_due_ns() <= NEVER_NS


def test_an_interface_that_cannot_be_served_is_a_device_error(encoder_bench):
    with pytest.raises(DeviceError, match="cannot be served"):
        CanTransport(encoder_bench().channel, interface="socketcan", address="can77")


def test_channel_names_are_exclusive_and_listed(encoder_bench):
    bench = encoder_bench()
    with pytest.raises(UsageError, match="exists already"):
        CanChannel(bench.world, bench.channel.name).open()
    assert {"interface": "hil", "channel": bench.channel.name} in can.detect_available_configs("hil")
    with pytest.raises(can.CanInitializationError, match=bench.channel.name):
        can.Bus(interface="hil", channel="nowhere")


def test_waiting_moves_the_world_and_filters_apply(encoder_bench):
    bench = encoder_bench()
    filters = [{"can_id": 417, "can_mask": 0x7FF}]
    with can.Bus(interface="hil", channel=bench.channel.name, can_filters=filters) as bus:
        first = bus.recv(timeout=None)
        assert first.arbitration_id == 417
        assert first.timestamp == pytest.approx(bench.clock.now_ns() * 1e-9)
        assert bus.recv(timeout=0.001) is None
        assert bus.recv(timeout=0.01).arbitration_id == 417
        assert next(iter(bus)).arbitration_id == 417


def test_a_channel_on_which_nothing_can_happen_does_not_hang(encoder_bench):
    from hil.fakes.world import World

    world = World(encoder_bench().plant)
    channel = CanChannel(world, "silent").open()
    with (
        can.Bus(interface="hil", channel="silent") as bus,
        pytest.raises(can.CanOperationError, match="nothing"),
    ):
        bus.recv()
    channel.close()
    channel.close()


def test_each_listener_has_a_frame_of_his_own_and_who_wants_it_hears_himself(encoder_bench):
    bench = encoder_bench("encoders:off@0")
    name = bench.channel.name
    with (
        can.Bus(interface="hil", channel=name, receive_own_messages=True) as talker,
        can.Bus(interface="hil", channel=name) as one,
        can.Bus(interface="hil", channel=name) as other,
    ):
        sent = can.Message(arbitration_id=7, data=b"abc", is_extended_id=False)
        talker.send(sent)
        heard = [bus.recv(0.1) for bus in (talker, one, other)]
        assert [bytes(message.data) for message in heard] == [b"abc"] * 3
        heard[0].data[0] = 0
        assert [bytes(m.data) for m in (sent, *heard[1:])] == [b"abc"] * 3
        assert sent.timestamp == 0.0
        one.send(sent)
        assert one.recv(0.1) is None
        assert [message.is_rx for message in heard] == [False, True, True], "its own frame is no received one"
        assert {message.channel for message in heard} == {name}
        with pytest.raises(can.CanOperationError, match="FD"):
            talker.send(can.Message(arbitration_id=7, data=bytes(12), is_fd=True))


def test_frames_are_sent_periodically_in_world_time(encoder_bench):
    """As a python-can client does it on any interface; its own thread would go by this computer's clock."""
    bench = encoder_bench("encoders:off@0")
    with (
        can.Bus(interface="hil", channel=bench.channel.name) as talker,
        can.Bus(interface="hil", channel=bench.channel.name) as listener,
    ):
        frames = [can.Message(arbitration_id=7, data=bytes((k,)), is_extended_id=False) for k in range(2)]
        task = talker.send_periodic(frames, 0.02, duration=0.5)
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 3_000_000_000)
        heard = [message for message in iter(lambda: listener.recv(0), None) if message.arbitration_id == 7]
        assert [message.data[0] for message in heard] == [0, 1] * 12 + [0]
        assert np.diff([message.timestamp for message in heard]) == pytest.approx(0.02, abs=1e-9)
        task.modify_data([can.Message(arbitration_id=7, data=b"x", is_extended_id=False)] * 2)
        task.start()
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 110_000_000)
        talker.stop_all_periodic_tasks()
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 1_000_000_000)
        again = [message for message in iter(lambda: listener.recv(0), None) if message.arbitration_id == 7]
        assert [bytes(message.data) for message in again] == [b"x"] * 6
