"""Where `hil emulate` serves motion capture: at the ports of the bench file, at Motive's, or at free ones."""

import contextlib
import os
import socket
import subprocess
import sys
import threading

import pytest
from natnet import NatNetClient

import hil
from hil.bench.emulated_devices import build_world
from hil.cli import main
from hil.config.loading import load_bench
from hil.fakes.free_port import free_udp_port
from hil.fakes.mocap.natnet.chip import NatNetServer
from hil.fakes.mocap.natnet.udp import NatNetTransport

pytestmark = pytest.mark.usefixtures("warm_commands")

MOTIVE = (1510, 1511)
GROUP = f"239.255.42.{1 + os.getpid() % 250}"


@pytest.fixture
def bench_file(tmp_path):
    def write(**keys):
        path = tmp_path / "bench.toml"
        mocap = "".join(f"{key} = {value!r}\n" for key, value in {"backend": "emulated", **keys}.items())
        path.write_text(f'schema = 1\nname = "table"\n[mocap]\n{mocap}')
        return str(path)

    return write


@pytest.fixture
def motive_ports():
    """Motive's command port, where no other program on this host has it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", MOTIVE[0]))
        except OSError:
            pytest.skip("another program on this host has Motive's port 1510")
    return MOTIVE


def frames_of(client, wanted=20, seconds=10.0):
    """Frames that the public client gets; stops at `wanted`."""
    frames, enough = [], threading.Event()

    def take(frame):
        frames.append(frame)
        if len(frames) >= wanted:
            enough.set()

    client.on_data_frame_received_event.handlers.append(take)
    with client:
        client.run_async()
        enough.wait(seconds)
        client.stop_async()
    return frames


@pytest.mark.parametrize("multicast", [None, GROUP], ids=["unicast", "multicast"])
def test_the_ports_and_the_group_of_the_bench_file_are_served(emulate, bench_file, multicast):
    command_port, data_port = free_udp_port(), free_udp_port()
    keys = {"command_port": command_port, "data_port": data_port}
    where = emulate("--bench", bench_file(**keys, **({"multicast": multicast} if multicast else {})))["mocap"]
    assert where == {"server": "127.0.0.1", **keys, "multicast": multicast}
    client = NatNetClient(
        command_port=command_port,
        data_port=data_port,
        use_multicast=multicast is not None,
        multicast_address=multicast or "239.255.42.99",
    )
    assert len(frames_of(client)) >= 20


def test_without_ports_in_the_bench_file_they_are_free_ones(emulate, bench_file):
    file = bench_file()
    first, second = (emulate("--bench", file)["mocap"] for _ in range(2))
    assert MOTIVE[0] not in (first["command_port"], second["command_port"])
    assert first["command_port"] != second["command_port"]


def test_a_client_that_knows_only_the_standard_connects_by_either_transport(emulate, motive_ports):
    where = emulate("--only", "mocap", "--standard-ports")["mocap"]
    assert (where["command_port"], where["data_port"]) == motive_ports
    for multicast in (False, True):
        numbers = [frame.prefix.frame_number for frame in frames_of(NatNetClient(use_multicast=multicast))]
        assert len(numbers) >= 20
        assert len(set(numbers)) == len(numbers), "each frame comes once, whatever else is offered"


OPTITRACK = """
import os, threading
from natnetsdk.NatNetClient import NatNetClient
poses, enough = [], threading.Event()
def take(identifier, position_m, rotation_xyzw):
    poses.append((identifier, *position_m))
    if len(poses) > 50:
        enough.set()
client = NatNetClient()
client.set_print_level(0)
client.set_client_address("127.0.0.1")
client.set_server_address("127.0.0.1")
client.set_use_multicast(False)
client.rigid_body_listener = take
client.run()
enough.wait(20)
print(len(poses), poses[-1:], flush=True)
os._exit(not enough.is_set())
"""


@pytest.mark.real_time
def test_optitracks_own_client_takes_the_frames(emulate, motive_ports):
    """It reads two precision stamps at the end of every frame of NatNet 4: without them it takes none."""
    emulate("--only", "mocap", "--standard-ports")
    done = subprocess.run([sys.executable, "-c", OPTITRACK], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout[-500:] + done.stderr[-500:]


def test_multicast_never_leaves_the_host():
    world = build_world(load_bench("emulated"), seed=1)
    transport = NatNetTransport(NatNetServer(world, multicast=GROUP))
    with socket.socket(fileno=os.dup(transport.filenos()[0])) as sender:
        assert sender.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL) == 0
        interface = sender.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, 4)
        assert socket.inet_ntoa(interface) == "127.0.0.1"
    transport.close()


def test_a_port_in_use_is_named_with_what_can_be_done(bench_file, capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        port = holder.getsockname()[1]
        assert main(["emulate", "--bench", bench_file(command_port=port)]) == 3
    said = capsys.readouterr()
    assert said.out == ""
    assert f"127.0.0.1:{port}" in said.err
    assert "already in use" in said.err
    assert "mocap.command_port" in said.err


@pytest.mark.parametrize(
    ("realtime", "multicast"), [(True, None), (False, GROUP)], ids=["wire-unicast", "virtual-multicast"]
)
def test_a_bench_reads_an_emulated_server_whose_ports_it_names(bench_file, realtime, multicast):
    with contextlib.ExitStack() as stack:
        holder = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        holder.bind(("127.0.0.1", 0))
        keys = {"command_port": holder.getsockname()[1], "data_port": free_udp_port()}
        file = bench_file(**keys, **({"multicast": multicast} if multicast else {}))
        bench = hil.open_bench(file, realtime=realtime)
        stack.callback(bench.close)
        bench.begin()
        mocap = bench.devices.get("mocap")
        mocap.open()
        stack.callback(mocap.close)
        seen = []
        for _ in range(500):
            seen += mocap.read()
            if len(seen) > 20:
                break
            bench.clock.sleep_until_ns(bench.clock.now_ns() + 10_000_000)
    assert len(seen) > 20
