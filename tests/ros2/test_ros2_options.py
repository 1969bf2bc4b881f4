"""`--ros2` of `hil run` and `hil live`: what goes out, on which network, and what is refused."""

import json
import pickle
import signal
import subprocess
import sys

import numpy as np
import pytest

from hil.cli import main
from hil.config.ros2 import Ros2Config
from hil.core.errors import ConfigError
from hil.procedure.bench_source import BenchSource
from hil.recording.mcap_reader import read_cycles
from hil.support import extras
from tests.patience import patient_bench

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
from hil.ros2.network import Network, domain_of, network_of
from hil.ros2.publisher import Ros2Publisher

pytestmark = pytest.mark.usefixtures("warm_commands")
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
    recorded = {sample.position_rad.tobytes() for sample in servos}  # NaN where no servo answered in time
    assert len(heard["/joint_states"]) > 10
    positions = [fields["position"] for _, _, fields in heard["/joint_states"]]
    assert {np.array(angles, dtype=np.float64).tobytes() for angles in positions} <= recorded
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


@pytest.mark.parametrize(
    ("options", "environment", "answer"),
    [
        (("live", "--ros2-domain", "3"), {}, "--ros2"),
        (("run", "bring_up", "--ros2", "--ros2-domain", "102"), {}, "102"),
        (("live", "--ros2"), {"ROS_DOMAIN_ID": "home"}, "ROS_DOMAIN_ID"),
        (("live", "--ros2", "--ros2-interface", "nosuch0"), {}, "nosuch0"),
        (("run", "bring_up", "--controller", "ros2:cmd vel"), {}, "name of a ROS 2 topic"),
        (("live", "--controller", "ros2:/cmd_vel", "--command", "stdin"), {}, "--command"),
        (("live", "--controller", "ros2:/cmd_vel", "--replay", "way.csv"), {}, "--replay"),
    ],
)
def test_what_cannot_be_meant_is_refused_before_anything_opens(
    options, environment, answer, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    (tmp_path / "way.csv").write_text("x,y,theta\n0,0,0\n0.05,0,0\n")
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert main([*options]) == 2
    error = capsys.readouterr().err
    assert answer in error
    assert "Traceback" not in error
    assert not any(tmp_path.rglob("*.mcap"))


def test_without_the_extra_the_line_that_installs_it_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(extras, "is_installed", lambda extra: extra != "ros2")
    assert main(["live", "--ros2"]) == 2
    error = capsys.readouterr().err
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
    ("names", "answer"),
    [({"/nosuch": "/other"}, "/nosuch"), ({"/imu/data": "/same", "/joint_states": "/same"}, "one name")],
)
def test_names_that_cannot_be_meant_are_refused(names, answer, domain):
    publisher = Ros2Publisher(Network(domain))
    source = BenchSource("emulated", publish=publisher.sink, overrides={"ros2.names": names})
    try:
        with pytest.raises(ConfigError, match=answer):
            source.open()
    finally:
        publisher.close()
