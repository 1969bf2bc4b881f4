"""The ways to a sender: UDP and serial, in world time and in real time, and what can be wrong with them."""

import contextlib
import socket
import threading

import numpy as np
import pytest
from following import follow, kinds
from pydantic import ValidationError

from hil.config.mavlink import MavlinkTrackerConfig
from hil.core.clock import MonotonicClock
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.signals import Status
from hil.drivers.tracker.mavlink.driver import MavlinkTracker
from hil.fakes.free_port import free_udp_port
from hil.fakes.serial_line import SerialLine
from hil.fakes.server import EmulationServer
from hil.fakes.tracker.mavlink.chip import ComputerTruthOptions
from hil.fakes.tracker.mavlink.links import MavlinkTransport, SerialComputer

pytestmark = pytest.mark.alone

pytest.importorskip("pymavlink", reason="the extra mavlink is not installed")

BAUD = 921_600
_TRIES = 10


@contextlib.contextmanager
def serving(world, transport):
    server = EmulationServer(world, MonotonicClock(), {"tracker": transport})
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield
    finally:
        server.stop()
        thread.join(10)


class RealTime:
    """A driver on the host's clock, as `follow` wants it."""

    def __init__(self, **config):
        self.clock = MonotonicClock()
        self.driver = MavlinkTracker(MavlinkTrackerConfig(**config), self.clock)


def check_poses(samples, least):
    assert len(samples) > least
    assert kinds(samples).count(Status.OK) > 0.9 * len(samples)
    assert np.linalg.norm(samples[-1].position_m - samples[0].position_m) > 0.02
    ages_ns = [s.stamp.host_ns - s.stamp.t_ns for s in samples]
    assert 15e6 < np.median(ages_ns) < 40e6


def test_a_driver_that_speaks_first_follows_a_computer_on_udp(mavlink_bench):
    bench = mavlink_bench(options=ComputerTruthOptions())
    transport = MavlinkTransport(bench.computer)
    real = RealTime(port=transport.endpoint()["port"], system_id=transport.endpoint()["system_id"])
    with serving(bench.world, transport):
        real.driver.open()
        assert real.driver.identity()["component"] == "197 (visual_inertial_odometry)"
        assert real.driver.identity()["firmware"] == "1.4.2"
        for _ in range(_TRIES):  # a busy computer has long round trips itself
            check_poses(follow(real, 1.0), 60)
            level = {f.check: f.level for f in real.driver.findings()}["time"]
            if level == "ok":
                break
        assert level == "ok"
        real.driver.close()
        real.driver.open()
        assert follow(real, 0.2)
        real.driver.close()
    assert transport.filenos() == []
    transport.close()


def test_a_driver_that_waits_follows_a_computer_that_was_reported_its_address(mavlink_bench):
    bench, port = mavlink_bench(options=ComputerTruthOptions()), free_udp_port()
    transport = MavlinkTransport(bench.computer, target=("127.0.0.1", port))
    real = RealTime(port=f"udpin:127.0.0.1:{port}")
    with serving(bench.world, transport):
        real.driver.open()
        check_poses(follow(real, 1.0), 60)
        assert real.driver.findings()[1].found.startswith("round trip")
        real.driver.close()


@pytest.fixture
def serial_bench(mavlink_bench):
    """A driver on a serial line in world time."""
    lines = []

    def build(*faults, **config):
        bench = mavlink_bench(*faults, options=ComputerTruthOptions())
        chip = SerialComputer(bench.computer, baud=BAUD)
        lines.append(SerialLine(bench.world, chip, name=f"mavlink-{len(lines)}").open())
        bench.world.faults.check()
        bench.config = MavlinkTrackerConfig(port=f"hil://mavlink-{len(lines) - 1}", **config)
        bench.driver = MavlinkTracker(bench.config, bench.clock)
        return bench

    yield build
    for line in lines:
        line.close()


def test_a_serial_line_in_world_time(serial_bench):
    bench = serial_bench()
    bench.driver.open()
    check_poses(follow(bench, 2.0), 190)
    assert bench.driver.counts["lost"] == 0
    bench.driver.close()
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 2_000_000_000)
    bench.driver.open()
    first = follow(bench, 0.2)[0]
    assert first.stamp.host_ns - first.stamp.t_ns < 40_000_000
    bench.driver.close()


def test_what_lay_in_a_serial_ports_buffer_is_no_sign_of_life(serial_bench):
    bench = serial_bench("tracker:off@5", open_timeout_s=1.0)
    bench.driver.open()
    bench.driver.close()
    bench.clock.sleep_until_ns(6_000_000_000)
    with pytest.raises(DeviceTimeoutError, match="nothing arrives within 1 s"):
        bench.driver.open()


def test_a_serial_line_at_another_rate_is_distinguished_from_silence(serial_bench):
    bench = serial_bench(baud=57_600, open_timeout_s=1.0)
    with pytest.raises(DeviceTimeoutError, match=r"no MAVLink.*talks at 57600 baud"):
        bench.driver.open()


def test_wire_faults_of_the_serial_line(serial_bench):
    bench = serial_bench("tracker:corrupt@3+1,probability=0.5", "tracker:unplug@5")
    bench.driver.open()
    with pytest.raises(DeviceTimeoutError, match=r"damaged pieces.*the port has failed"):
        follow(bench, 10.0)
    assert bench.driver.counts["malformed"] > 20


def test_nothing_at_the_other_end_says_where_to_look():
    port = free_udp_port()
    with pytest.raises(DeviceTimeoutError, match=f"nothing arrives within 0.2 s.*UDP port {port} of this"):
        RealTime(port=f"udpin:127.0.0.1:{port}", open_timeout_s=0.2).driver.open()
    with pytest.raises(DeviceTimeoutError, match=r"sender listens at 127.0.0.1, UDP port"):
        RealTime(port=f"udpout:127.0.0.1:{port}", open_timeout_s=0.2).driver.open()


def test_a_port_that_another_program_holds_or_that_is_not_there_is_a_device_error(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        with pytest.raises(DeviceError, match=rf"cannot be used.*ss -lunp sport = :{port}") as caught:
            RealTime(port=f"udpin:127.0.0.1:{port}").driver.open()
    assert caught.value.exit_code == 3
    assert caught.value.port == f"udpin:127.0.0.1:{port}"
    with pytest.raises(DeviceError, match="port cannot be opened"):
        RealTime(port=str(tmp_path / "ttyUSB0")).driver.open()
    with pytest.raises(DeviceError, match=r"check tracker\.port"):
        RealTime(port="udpin:203.0.113.7:14550").driver.open()


def test_another_program_that_sends_to_the_port_is_distinguished_from_a_sender(by_hand):
    bench = by_hand(opened=False)
    bench.link.arrive(raw=b'{"not": "mavlink"}')
    with pytest.raises(DeviceTimeoutError, match=r"what arrives is no MAVLink.*another program"):
        bench.driver.open()
    assert bench.link.closed == 1


def test_who_speaks_first_is_answered_before_it_sends_odometry(by_hand, common):
    """Many senders stream only to those whose heartbeats they hear."""
    bench = by_hand(opened=False)
    bench.link.arrive(common.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
    with pytest.raises(DeviceTimeoutError):
        bench.driver.open()
    beats = [to for m, to in bench.link.sent if m.get_type() == "HEARTBEAT"]
    assert len(beats) >= 4
    assert set(beats) == {("10.0.0.2", 14555)}


def test_an_autopilot_without_odometry_is_named(by_hand, common):
    bench = by_hand(opened=False)
    bench.link.arrive(common.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3), source=(1, 1))
    with pytest.raises(DeviceTimeoutError, match="system 1 component 1 sends HEARTBEAT, but no ODOMETRY"):
        bench.driver.open()


@pytest.mark.parametrize("config", [{"system_id": 2}, {"component_id": 191}])
def test_a_sender_with_other_ids_is_refused_by_name(by_hand, odometry, config):
    bench = by_hand(config, opened=False)
    bench.link.arrive(odometry(1.0))
    with pytest.raises(DeviceError, match=r"comes from system 1 component 197 only.*tracker\.system_id"):
        bench.driver.open()


def test_the_first_sender_stays_the_one_and_others_are_counted(by_hand, odometry):
    bench = by_hand()
    bench.link.arrive(odometry(5.0, x=9.0), odometry(5.01, x=9.0), source=(7, 197))
    samples = bench.send(0.1)
    assert max(abs(s.position_m[0]) for s in samples) < 0.1
    assert bench.driver.counts["strangers"] == 2
    assert "also heard: 7/197" in bench.driver.findings()[0].found


@pytest.mark.parametrize(("config", "frames"), [({}, {"frame_id": 0}), ({"frame": "LOCAL_NED"}, {})])
def test_frames_that_cannot_be_used_are_refused_at_open(by_hand, config, frames):
    with pytest.raises(DeviceError, match=r"the pose is given in .*MAV_FRAME_LOCAL_FRD"):
        by_hand(config, **frames)


def test_an_unknown_quality_is_usable_and_a_missing_twist_is_not_a_number(by_hand):
    bench = by_hand()
    samples = bench.send(0.1, quality=0, vx=np.nan)
    assert kinds(samples) == [Status.OK] * 10
    assert {s.confidence for s in samples} == {2}
    assert all(np.isnan(s.velocity_m_s).all() and np.isfinite(s.position_m).all() for s in samples)


def test_this_host_says_that_it_is_there_once_a_second(by_hand):
    bench = by_hand()
    bench.send(3.0)
    sent = [m.get_type() for m, _ in bench.link.sent]
    assert sent.count("HEARTBEAT") == 5
    assert sent.count("COMMAND_LONG") == 3
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m, _ in bench.link.sent} == {(255, 190)}


@pytest.mark.parametrize("port", ["tcp:10.0.0.1:5760", "udpin:0.0.0.0", "udpin:host:70000"])
def test_a_connection_that_cannot_be_meant_is_refused(port):
    with pytest.raises(ValidationError, match=r"udpin:HOST:PORT|1 \.\. 65535"):
        MavlinkTrackerConfig(port=port)


def test_a_computer_forgets_listeners_that_fall_silent_and_cannot_have_a_taken_port(mavlink_bench):
    bench = mavlink_bench()
    transport = MavlinkTransport(bench.computer)
    bench.world.add(transport)
    port = int(transport.endpoint()["port"].rsplit(":", 1)[1])
    with pytest.raises(DeviceError, match="cannot be served"):
        MavlinkTransport(bench.computer, port=port)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(2.0)
        client.sendto(b"hello", ("127.0.0.1", port))
        transport.on_readable(transport.filenos()[0], 0)
        bench.clock.sleep_until_ns(1_000_000_000)
        assert client.recv(2048)[:1] == b"\xfd"
        bench.clock.sleep_until_ns(7_000_000_000)
        client.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                client.recv(2048)
        bench.clock.sleep_until_ns(8_000_000_000)
        with pytest.raises(BlockingIOError):
            client.recv(2048)
    transport.close()
    transport.on_readable(0, 0)
