"""`--ros2` of `hil run` and `hil live`: what goes out, on which network, and what is refused."""

import json
import os
import pickle
import signal
import socket
import struct
import subprocess
import sys
import threading
import time

import pytest

from hil.cli import main
from hil.config.ros2 import Ros2Config
from hil.core.errors import ConfigError
from hil.procedure.bench_request import BenchSource
from hil.recording.mcap_reader import read_cycles
from hil.support import extras
from tests.patience import patient_bench

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
from hil.ros2.network import Network, domain_of, network_of
from hil.ros2.publisher import Ros2Publisher

PATIENCE_S = 240.0
WATCHES = """
from pathlib import Path
from hil.procedure import Context, procedure

@procedure(name="watches", needs=("servos",))
def run(ctx: Context) -> None:
    \"\"\"Watches until it has been heard.\"\"\"
    for _ in range(2):
        bench = ctx.reopen()
        while not Path("heard").exists():
            bench.observe(0.1)
        bench.observe(0.2)
"""


def command(folder, *words):
    return subprocess.Popen(
        [sys.executable, "-m", "hil", *words, "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
    )


@pytest.mark.real_time
@pytest.mark.timeout(PATIENCE_S + 60)
def test_a_live_loop_is_heard_and_says_goodbye_when_it_is_ended(tmp_path, domain, listen):
    bench = patient_bench(tmp_path, "emulated")
    listener = listen("/joint_states", "/diagnostics")
    live = command(
        tmp_path, "live", "--bench", str(bench), "--ros2", "--ros2-domain", str(domain), "--record", "r.mcap"
    )
    try:
        listener.matched()
        listener.has_heard()
        listener.end()
        live.send_signal(signal.SIGTERM)
        out, err = live.communicate(timeout=PATIENCE_S)
    finally:
        live.kill()
    heard, gone_after_s = listener.heard()
    assert live.returncode == 4, err
    assert json.loads(out)["held"]["state"] == "HELD"
    assert f"domain {domain}, loopback only" in err
    servos = [c.inputs.servos[0] for c in read_cycles(tmp_path / "r.mcap") if c.inputs.servos]
    recorded = {tuple(sample.position_rad) for sample in servos}
    assert len(heard["/joint_states"]) > 10
    assert {tuple(fields["position"]) for _, _, fields in heard["/joint_states"]} <= recorded
    last = heard["/diagnostics"][-1][2]["status"][-1]
    assert last["message"].startswith("HELD")
    assert gone_after_s is not None


@pytest.mark.real_time
@pytest.mark.timeout(PATIENCE_S + 60)
def test_a_procedure_is_heard_on_every_bench_that_it_opens(tmp_path, domain, listen):
    (tmp_path / "watches.py").write_text(WATCHES)
    listener = listen("/clock", "/odom", "/diagnostics")
    run = command(tmp_path, "run", "watches.py", "--out", "results", "--ros2", "--ros2-domain", str(domain))
    try:
        listener.matched()
        (tmp_path / "heard").touch()
        out, err = run.communicate(timeout=PATIENCE_S)
    finally:
        run.kill()
    heard, _ = listener.heard()
    assert run.returncode == 0, err + out
    assert len(heard["/odom"]) > 10
    held = [s for _, _, m in heard["/diagnostics"] for s in m["status"] if s["name"] == "hil: held"]
    assert len(held) == 2


def sent_out(domain, ended):
    """Where packets of a domain went that left by an interface other than loopback, until `ended`."""
    ports = range(7400 + 250 * domain, 7650 + 250 * domain)
    found = set()
    with socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.ntohs(3)) as raw:
        raw.settimeout(0.1)
        while not ended.is_set():
            try:
                data, (name, kind, *_) = raw.recvfrom(65536)
            except TimeoutError:
                continue
            if name == "lo" or kind != 0x0800 or len(data) < 28 or data[9] != socket.IPPROTO_UDP:
                continue
            begin = 4 * (data[0] & 15)
            if any(port in ports for port in struct.unpack_from("!2H", data, begin)):
                found.add((name, socket.inet_ntoa(data[16:20])))
    return found


def outward():
    """An interface that leads off this computer, with an address; None without one."""
    for _, name in socket.if_nameindex():
        state = f"/sys/class/net/{name}/operstate"
        if name != "lo" and os.path.exists(state):
            with open(state) as file:
                if file.read().strip() == "up" and _address(name):
                    return name
    return None


def _address(name):
    import fcntl

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            return fcntl.ioctl(probe, 0x8915, struct.pack("256s", name.encode()))[20:24]  # SIOCGIFADDR
        except OSError:
            return None


@pytest.mark.real_time
@pytest.mark.parametrize("named", [False, True])
def test_nothing_leaves_this_computer_unless_an_interface_is_named(domain, named):
    """The second half shows that the first would see what leaves."""
    interface = outward()
    if interface is None:
        pytest.skip("this computer has no network")
    try:
        socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, 0).close()
    except PermissionError:
        pytest.skip("seeing packets takes the rights of root")
    ended, found = threading.Event(), []
    watch = threading.Thread(target=lambda: found.append(sent_out(domain, ended)))
    watch.start()
    publisher = Ros2Publisher(Network(domain, interface if named else ""))
    try:
        with BenchSource("emulated", publish=publisher.sink).open() as bench:
            bench.observe(0.2)
        time.sleep(2.0)  # two announcements
    finally:
        publisher.close()
        ended.set()
        watch.join()
    names = {name for name, _ in found[0]}
    assert names == ({interface} if named else set())


@pytest.mark.parametrize(
    ("options", "environment", "told"),
    [
        (("--ros2-domain", "3"), {}, "--ros2"),
        (("--ros2-interface", "eth0"), {}, "--ros2"),
        (("--ros2", "--ros2-domain", "102"), {}, "102"),
        (("--ros2",), {"ROS_DOMAIN_ID": "home"}, "ROS_DOMAIN_ID"),
        (("--ros2",), {"ROS_DOMAIN_ID": "-1"}, "ROS_DOMAIN_ID"),
        (("--ros2", "--ros2-interface", "nosuch0"), {}, "nosuch0"),
    ],
)
@pytest.mark.parametrize("words", [("live",), ("run", "bring_up", "--quick")])
def test_what_cannot_be_meant_is_refused_before_anything_opens(
    words, options, environment, told, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert main([*words, *options]) == 2
    error = capsys.readouterr().err
    assert told in error
    assert "Traceback" not in error
    assert not any(tmp_path.rglob("*.mcap"))


def test_without_the_extra_the_line_that_installs_it_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(extras, "is_installed", lambda extra: extra != "ros2")
    assert main(["live", "--ros2"]) == 2
    error = capsys.readouterr().err
    assert "extra ros2" in error
    assert extras.how_to_install("ros2") in error


def test_the_domain_is_the_one_asked_for_else_that_of_the_environment():
    assert domain_of(7, {"ROS_DOMAIN_ID": "nonsense"}) == 7
    assert domain_of(None, {"ROS_DOMAIN_ID": "42"}) == 42
    assert domain_of(None, {"ROS_DOMAIN_ID": ""}) == 0
    assert domain_of(None, {}) == 0


def test_what_another_process_opens_is_not_published():
    source = BenchSource("emulated", seed=3, publish=len)
    sent = pickle.loads(pickle.dumps(source))
    assert sent == source
    assert sent.publish is None


def test_the_bench_file_says_where_the_bench_is_unless_the_command_line_does():
    config = Ros2Config(domain=5, interface="lo")
    assert network_of(config, {"ROS_DOMAIN_ID": "3"}) == Network(5, "lo")
    assert network_of(config, {}, domain=6, interface="eth7") == Network(6, "eth7")
    assert network_of(Ros2Config(), {"ROS_DOMAIN_ID": "3"}) == Network(3)


@pytest.mark.timeout(PATIENCE_S + 60)
def test_a_topic_has_the_name_that_the_bench_file_gives_it(domain, listen):
    listener = listen("/robot_joint_states")
    publisher = Ros2Publisher(Network(domain))
    names = {"ros2.names": {"/joint_states": "/robot_joint_states"}}
    try:
        with BenchSource("emulated_floor", publish=publisher.sink, overrides=names).open() as bench:
            listener.wait(publisher.participant, "/joint_states")
            bench.observe(0.3, feedback="odometry")
    finally:
        publisher.close()
    heard, _ = listener.heard()
    assert len(heard["/robot_joint_states"]) > 10


@pytest.mark.parametrize(
    ("names", "told"),
    [
        ({"/nosuch": "/other"}, "/nosuch"),
        ({"joint states": "/other"}, "joint states"),
        ({"/imu/data": "/same", "/joint_states": "/same"}, "one name"),
    ],
)
def test_names_that_cannot_be_meant_are_refused(names, told, domain):
    publisher = Ros2Publisher(Network(domain))
    source = BenchSource("emulated", publish=publisher.sink, overrides={"ros2.names": names})
    try:
        with pytest.raises(ConfigError, match=told):
            source.open()
    finally:
        publisher.close()
