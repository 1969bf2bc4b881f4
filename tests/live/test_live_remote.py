"""The bench stands elsewhere: serial ports by TCP and RFC 2217, CAN by socketcand, with latency added."""

import json
import subprocess
import sys

import can
import numpy as np
import pytest
from remote_bridges import Bridge, SocketCanDaemon

import hil
from hil.core.clock import MonotonicClock
from hil.core.errors import DeviceError
from hil.drivers.servos.dynamixel.commissioning import scan
from hil.links.serial_over_tcp import RemotePort
from hil.links.serial_url import open_serial
from hil.robot.kinematics import WheelGeometry
from hil.robot.trajectories import line

LATENCY_S = 0.003
BAUD = 3_000_000
STRAIGHT = line((0.0, 0.0, 0.0), (0.04, 0.0, 0.0), duration_s=1.5)

pytestmark = [
    pytest.mark.timeout(900),  # the first process to start may compile the estimators
    pytest.mark.usefixtures("warm_commands"),
]


@pytest.fixture(scope="module")
def served():
    """Endpoints of emulated servos, IMU and encoders on a floor, served by another process."""
    words = ("emulate", "--bench", "emulated_floor", "--only", "servos,imu,encoders")
    child = subprocess.Popen([sys.executable, "-m", "hil.cli", *words], stdout=subprocess.PIPE, text=True)
    yield json.loads(child.stdout.readline())
    child.terminate()
    child.communicate(timeout=20)


def test_servos_behind_a_raw_socket_are_found_once_whatever_rate_is_asked(served):
    """Its server sets the baud rate; the servos answer at any that the client believes."""
    bridge = Bridge(served["servos"]["port"], baud=BAUD, latency_s=0.0, protocol="socket")
    try:
        found = scan(bridge.url, MonotonicClock())
    finally:
        bridge.close()
    assert [servo.servo_id for servo in found] == list(range(1, 9))


def bench_file(tmp_path, servos, imu, encoders, *, prefetch="false"):
    path = tmp_path / "remote.toml"
    path.write_text(
        f"""schema = 1
name = "remote"
[environment]
surface = "floor"
tilt_rad = 0.0
[loop]
rate_hz = 25.0
[safety]
servo_stale_s = 0.5
[servos]
port = "{servos}"
baud = {BAUD}
prefetch = {prefetch}
reply_slack_s = 0.05
[imu]
port = "{imu}"
prefetch = {prefetch}
reply_timeout_s = 0.2
retry_budget_s = 0.4
[encoders]
{encoders}
"""
    )
    return path


def drive_and_check(path):
    with hil.open_bench(path) as bench:
        motion = bench.drive(STRAIGHT, feedback="ekf", hold_s=0.3, start_pose=(0.0, 0.0, 0.0))
    samples = [r.inputs.servos[-1] for r in motion.records]
    good = sum(s.ok for s in samples)
    assert good >= 0.9 * len(samples)
    travel_rad = samples[-1].position_rad[:4] - samples[0].position_rad[:4]
    np.testing.assert_allclose(travel_rad, 0.04 / WheelGeometry.nominal().radius_m, atol=0.12)
    assert sum(bool(r.inputs.imu) for r in motion.records) >= 0.8 * len(samples)
    assert sum(len(r.inputs.encoders) for r in motion.records) >= 0.8 * 200.0 * STRAIGHT.duration_s


@pytest.mark.parametrize("protocol", ["socket", pytest.param("rfc2217", marks=pytest.mark.long)])
def test_a_drive_on_a_remote_bench(served, tmp_path, protocol):
    """3 ms of latency each way: slower cycles or older samples, the same motion, hardly a sample lost."""
    channel, port = served["can"]["channel"], served["can"]["port"]
    near = can.Bus(interface="udp_multicast", channel=channel, port=port, hop_limit=0)
    daemon = SocketCanDaemon(near, latency_s=0.02)
    servos = Bridge(served["servos"]["port"], baud=BAUD, latency_s=LATENCY_S, protocol=protocol)
    imu = Bridge(served["imu"]["port"], baud=115_200, latency_s=LATENCY_S, protocol=protocol)
    encoders = 'interface = "socketcand"\nchannel = "can0"\n'
    encoders += f'options = {{ host = "127.0.0.1", port = {daemon.port} }}'
    prefetch = "true" if protocol == "rfc2217" else "false"
    try:
        drive_and_check(bench_file(tmp_path, servos.url, imu.url, encoders, prefetch=prefetch))
        assert servos.clients == imu.clients == 1
    finally:
        for bridge in (servos, imu, daemon):
            bridge.close()


def test_an_rfc2217_port_negotiates_once(served):
    """Timeouts that change and buffers that are cleared cost nothing; pyserial's own takes 50 ms each."""
    bridge = Bridge(served["imu"]["port"], baud=115_200, latency_s=LATENCY_S, protocol="rfc2217")
    try:
        port = open_serial(bridge.url, baud=115_200, timeout_s=0.1, write_timeout_s=0.1)
        assert isinstance(port, RemotePort)
        clock = MonotonicClock()
        before_ns = clock.now_ns()
        for k in range(200):
            port.timeout = 0.001 * (1 + k % 3)
            port.reset_input_buffer()
        assert clock.now_ns() - before_ns < 1_000_000_000
        port.close()
    finally:
        bridge.close()


def test_a_server_that_is_not_there_is_a_device_error(tmp_path):
    path = bench_file(
        tmp_path,
        "socket://127.0.0.1:9",
        "rfc2217://127.0.0.1:10",
        'interface = "udp_multicast"\nchannel = "239.74.163.9"',
    )
    with pytest.raises(DeviceError, match=r"encoders|servos|imu"), hil.open_bench(path):
        raise AssertionError("a bench that is not served was opened")
