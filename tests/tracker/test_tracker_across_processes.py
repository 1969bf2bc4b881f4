"""The camera served on UDP, and behind librealsense's own software device, both in real time."""

import contextlib
import importlib
import socket
import threading

import numpy as np
import pytest

from hil.config.tracker import T265Config
from hil.core.clock import MonotonicClock
from hil.core.errors import DeviceError
from hil.core.signals import Status
from hil.drivers.tracker.t265.driver import T265Tracker
from hil.drivers.tracker.t265.served_poses import FeedPipeline
from hil.fakes.server import EmulationServer
from hil.fakes.tracker.t265.pose_server import TrackerTransport
from hil.links.t265_datagrams import FEED_HEAD, FEED_MAGIC, FEED_SUBSCRIBE, INFO_RECORD, POSE_RECORD
from tests.tracker.software_device import SoftwareT265

pytestmark = pytest.mark.real_time


@contextlib.contextmanager
def serving(world, transports):
    server = EmulationServer(world, MonotonicClock(), transports)
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield
    finally:
        server.stop()
        thread.join(10)


def collect(driver, clock, duration_s):
    samples, t_ns = [], clock.now_ns()
    for _ in range(round(duration_s * 100)):
        t_ns += 10_000_000
        clock.sleep_until_ns(t_ns)
        samples += driver.read()
    return samples


def feed_config(transport, **more):
    endpoint = {key: transport.endpoint()[key] for key in ("host", "port")}
    return T265Config(endpoint=endpoint, **more)


def test_the_driver_follows_a_feed(tracker_bench):
    bench = tracker_bench()
    transport = TrackerTransport(bench.camera)
    clock = MonotonicClock()
    driver = T265Tracker(feed_config(transport), clock)
    with serving(bench.world, {"tracker": transport}):
        driver.open()
        samples = collect(driver, clock, 1.0)
        assert driver.identity()["serial"] == bench.camera.serial
        assert driver.identity()["port"] == "127.0.0.1:{port}".format(**transport.endpoint())
        driver.close()
        driver.open()
        again = collect(driver, clock, 0.2)
        driver.close()
    assert len(samples) > 120
    assert samples[-1].status is Status.OK
    assert samples[-1].velocity_m_s.size == 3
    assert np.linalg.norm(samples[-1].position_m - samples[0].position_m) > 0.02
    assert again[0].stamp.seq <= 10
    assert transport.filenos() == []
    transport.close()


def test_a_feed_serves_several_clients_and_forgets_the_silent(tracker_bench):
    bench = tracker_bench()
    transport = TrackerTransport(bench.camera)
    port = transport.endpoint()["port"]
    hello = FEED_HEAD.pack(FEED_MAGIC, FEED_SUBSCRIBE)
    bench.world.add(transport)
    with contextlib.ExitStack() as stack:
        clients = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2)]
        for client in clients:
            client.settimeout(2.0)
            for data in (b"", b"nonsense", hello):
                client.sendto(data, ("127.0.0.1", port))
                transport.on_readable(transport.filenos()[0], 0)
            assert len(client.recv(2048)) == INFO_RECORD.size
        assert transport.strange == 4
        transport.on_readable(transport.filenos()[0], 0)
        bench.clock.sleep_until_ns(500_000_000)
        assert [len(client.recv(2048)) for client in clients] == [POSE_RECORD.size] * 2
        bench.clock.sleep_until_ns(6_000_000_000)
    assert not bench.camera.streams_to(transport._pass_on)
    transport.close()
    transport.on_readable(0, 0)
    assert transport.next_due_ns() > bench.clock.now_ns()


def test_nothing_at_the_other_end_is_a_device_error(tracker_bench):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        config = T265Config(endpoint={"port": silent.getsockname()[1]})
        with pytest.raises(DeviceError, match="no emulated camera answers"):
            T265Tracker(config, MonotonicClock()).open()


def test_strange_datagrams_and_a_vanished_server_do_not_end_the_reception():
    """The other end answers the first subscription, sends rubbish, vanishes, and comes back."""
    info = INFO_RECORD.pack(FEED_MAGIC, 3, b"Intel RealSense T265", b"1", b"2")
    pose = POSE_RECORD.pack(FEED_MAGIC, 4, 1, 5.0, *range(13), 3)
    frames, arrived = [], threading.Event()

    class Request:
        serial = None

    def take(frame):
        frames.append(frame)
        arrived.set()

    server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    server.bind(("127.0.0.1", 0))
    server.settimeout(5.0)
    port = server.getsockname()[1]
    pipeline = FeedPipeline("127.0.0.1", port)

    def answer():
        client = server.recvfrom(2048)[1]
        for data in (b"rubbish", info, info, b"", b"\xff" * POSE_RECORD.size, pose):
            server.sendto(data, client)

    thread = threading.Thread(target=answer)
    thread.start()
    device = pipeline.start(Request(), take)
    thread.join()
    assert arrived.wait(5.0)
    assert device.supports("name")
    assert frames[0].get_pose_data().translation.x == 0
    assert frames[0].get_frame_number() == 1
    server.close()
    arrived.wait(0.0)
    arrived.clear()
    arrived.wait(0.4)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as back:
        back.bind(("127.0.0.1", port))
        back.settimeout(5.0)
        client = back.recvfrom(2048)[1]
        back.sendto(pose, client)
        assert arrived.wait(5.0)
    pipeline.stop()
    pipeline.stop()
    assert pipeline.strange >= 1
    assert len(frames) == 2


def test_a_port_in_use_cannot_be_served(tracker_bench):
    transport = TrackerTransport(tracker_bench().camera)
    with pytest.raises(DeviceError, match="cannot be served"):
        TrackerTransport(tracker_bench().camera, port=transport.endpoint()["port"])
    transport.close()


@pytest.fixture
def realsense():
    try:
        return importlib.import_module("pyrealsense2")
    except ImportError as error:
        pytest.skip(f"the extra t265 is not usable here: {error}")


def test_the_same_driver_runs_on_librealsenses_software_device(tracker_bench, realsense):
    bench = tracker_bench()
    device = SoftwareT265(bench.camera, realsense)
    clock = MonotonicClock()
    driver = T265Tracker(T265Config(), clock, pipeline=device.pipeline(), library=realsense)
    with serving(bench.world, {}):
        driver.open()
        samples = collect(driver, clock, 1.0)
        driver.close()
    device.close()
    assert driver.identity() == {}
    assert len(samples) > 150
    assert {s.status for s in samples} == {Status.OK}
    numbers = [s.stamp.seq for s in samples]
    assert np.mean(np.diff(numbers) == 1) > 0.95
    assert np.linalg.norm(samples[-1].position_m - samples[0].position_m) == pytest.approx(
        0.005 * (len(samples) - 1) * np.linalg.norm([0.05, 0.02 + 0.1 * 0.1489]), rel=0.2
    )


def test_without_a_camera_the_library_says_so(realsense):
    with pytest.raises(DeviceError, match=r"2\.53\.1"):
        T265Tracker(T265Config(connect_timeout_s=0.5), MonotonicClock()).open()
