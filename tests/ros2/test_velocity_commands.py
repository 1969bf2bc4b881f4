"""`hil live --controller ros2:TOPIC`: a program on ROS 2 drives the robot; what it may not do stops it."""

import contextlib
import io
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hil.cli import main
from hil.recording.mcap_reader import read_cycles
from tests.patience import patient_bench

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")

PATIENCE_S = 240
COMMANDER = Path(__file__).with_name("commander.py")


@pytest.fixture
def programs():
    """Begins programs; they are ended with the test."""
    begun = []

    def begin(*words, **options):
        begun.append(
            subprocess.Popen(
                [sys.executable, *map(str, words)],
                text=True,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                **options,
            )
        )
        return begun[-1]

    yield begin
    for one in begun:
        if one.poll() is None:
            one.kill()
        one.wait()
        for pipe in filter(None, (one.stdin, one.stdout, one.stderr)):
            pipe.close()


@pytest.fixture
def live(tmp_path, domain, programs):
    bench = patient_bench(tmp_path, "emulated_floor")

    def begin(*options):
        words = ("live", "--bench", bench, "--controller", "ros2:/cmd_vel", "--ros2-domain", domain)
        more = ("--record", "r.mcap", *options, "--json")
        return programs("-m", "hil", *words, *more, stderr=subprocess.PIPE, cwd=tmp_path)

    return begin


@pytest.fixture
def command(domain, programs):
    def begin(kind, *fields, rate_hz=50):
        begun = programs(COMMANDER, domain, "/cmd_vel", kind, rate_hz, *fields)
        assert begun.stdout.readline() == "begun\n"
        return begun

    return begin


def ended(live):
    out, err = live.communicate(timeout=PATIENCE_S)
    return live.returncode, json.loads(out), err


def verdict(path):
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        main(["replay", str(path), "--verify", "--json"])
    return json.loads(out.getvalue())["verdict"]


@pytest.fixture
def moves(listen):
    """Until the loop of a live session runs, and its settling is over."""
    listener = listen("/joint_states")

    def wait():
        listener.matched()
        listener.has_heard()
        time.sleep(1.5)

    return wait


@pytest.mark.alone
@pytest.mark.timeout(PATIENCE_S + 60)
@pytest.mark.parametrize("kind", ["Twist", pytest.param("TwistStamped", marks=pytest.mark.long)])
def test_it_drives_as_commanded_and_not_before(kind, tmp_path, live, command, moves):
    running = live()
    moves()
    assert command(kind, "linear.x=0.05", "angular.z=0.02").stdout.readline() == "matched\n"
    time.sleep(2.5)
    running.send_signal(signal.SIGTERM)
    code, answer, err = ended(running)
    assert code == 4, err
    assert answer["commands"]["accepted"] > 20
    assert answer["commands"]["refused"] == 0
    assert answer["held"]["state"] in ("HELD", "not needed")
    cycles = [c for c in read_cycles(tmp_path / "r.mcap") if np.isfinite(c.state.covariance).all()]
    speeds = np.array([np.zeros(3) if c.reference is None else c.reference.twist_body for c in cycles])
    still = np.argmax(speeds.any(axis=1))
    assert still > 10, "at rest until the first command"
    rates = np.array([c.setpoint.wheel_rate_rad_s for c in cycles])
    assert np.abs(rates[:still]).max() < 0.2
    np.testing.assert_allclose(speeds[still:].max(axis=0), [0.05, 0.0, 0.02], atol=1e-12)
    assert cycles[-1].state.pose_body_in_wall[0] - cycles[still].state.pose_body_in_wall[0] > 0.02
    assert verdict(tmp_path / "r.mcap") == "identical"


@pytest.mark.alone
@pytest.mark.timeout(PATIENCE_S + 60)
@pytest.mark.parametrize(
    ("fields", "answer"),
    [
        (("linear.x=nan",), "not finite"),
        (("angular.z=inf",), "not finite"),
        (("linear.z=0.1",), "off the wall"),
    ],
)
def test_what_it_cannot_mean_stops_the_robot_by_name(fields, answer, tmp_path, live, command, listen):
    running = live("--duration", "60")
    listener = listen("/joint_states")
    command("Twist", *fields)
    code, summary, _ = ended(running)
    _, gone_after_s = listener.heard()
    assert code == 3
    assert gone_after_s < 5.0, "it says goodbye: others do not take it for alive"
    assert answer in summary["ended"]
    assert "/cmd_vel" in summary["ended"]
    assert summary["held"]["state"] in ("HELD", "not needed")
    last = list(read_cycles(tmp_path / "r.mcap"))[-1]
    assert answer in last.events[-1].message
    assert not last.setpoint.wheel_rate_rad_s.any()
    assert verdict(tmp_path / "r.mcap") == "identical"


@pytest.mark.alone
@pytest.mark.timeout(PATIENCE_S + 60)
def test_a_second_publisher_stops_the_robot(live, command):
    running = live("--duration", "60")
    command("Twist", "linear.x=0.03")
    command("TwistStamped", "linear.x=-0.03")
    code, summary, _ = ended(running)
    assert code == 3
    assert "2 publishers" in summary["ended"]


@pytest.mark.alone
@pytest.mark.timeout(PATIENCE_S + 60)
def test_one_that_is_killed_brings_the_robot_to_rest(tmp_path, live, command, moves):
    running = live()
    moves()
    first = command("Twist", "linear.x=0.05")
    assert first.stdout.readline() == "matched\n"
    time.sleep(1.0)
    first.kill()
    time.sleep(2.0)
    running.send_signal(signal.SIGTERM)
    code, summary, err = ended(running)
    assert code == 4, err
    assert summary["commands"]["dead_man_stops"] == 1
    assert "no command for" in err
    cycles = [c for c in read_cycles(tmp_path / "r.mcap") if c.reference is not None]
    assert max(c.reference.twist_body[0] for c in cycles) == 0.05
    assert not cycles[-1].reference.twist_body.any()


@pytest.mark.alone
@pytest.mark.timeout(PATIENCE_S + 60)
def test_one_that_was_killed_and_comes_back_at_once_stops_the_robot_and_both_are_named(live, command, moves):
    running = live("--duration", "60")
    moves()
    first = command("Twist", "linear.x=0.03")
    assert first.stdout.readline() == "matched\n"
    time.sleep(0.5)
    first.kill()
    second = command("Twist", "linear.x=0.03")
    code, summary, _ = ended(running)
    assert code == 3
    for answer in ("ros2_publishers", f"process {first.pid}", f"process {second.pid}", "for up to 10 s"):
        assert answer in summary["ended"]
    assert summary["held"]["state"] in ("HELD", "not needed")


@pytest.mark.alone
@pytest.mark.timeout(PATIENCE_S + 60)
@pytest.mark.long
def test_one_that_comes_back_after_its_lease_drives_again_and_the_loss_was_told(
    tmp_path, live, command, moves
):
    running = live()
    moves()
    first = command("Twist", "linear.x=0.03", "lease=2")
    assert first.stdout.readline() == "matched\n"
    time.sleep(0.5)
    first.kill()
    lost = next(line for line in running.stderr if "is gone" in line)
    assert f"process {first.pid} (geometry_msgs/Twist)" in lost
    assert command("Twist", "linear.x=0.04").stdout.readline() == "matched\n"
    time.sleep(1.5)
    running.send_signal(signal.SIGTERM)
    code, summary, _ = ended(running)
    assert code == 4
    assert summary["commands"]["publishers_lost"] == 1
    assert summary["commands"]["dead_man_stops"] >= 1
    speeds = [c.reference.twist_body[0] for c in read_cycles(tmp_path / "r.mcap") if c.reference is not None]
    before, after = speeds.index(0.03), speeds.index(0.04)
    assert 0.0 in speeds[before:after], "at rest while there is none"


@pytest.mark.alone
@pytest.mark.timeout(PATIENCE_S + 60)
def test_without_a_publisher_it_says_where_it_looked_and_which_other_type_it_found(live, command, domain):
    command("Header")
    code, summary, err = ended(live("--duration", "8"))
    assert code == 0, err
    assert summary["commands"]["cycles"] == 0
    for answer in (
        "/cmd_vel",
        "geometry_msgs/TwistStamped",
        f"domain {domain}",
        "std_msgs::msg::dds_::Header_",
    ):
        assert answer in err


@pytest.mark.alone
@pytest.mark.timeout(PATIENCE_S + 60)
def test_of_a_publisher_that_sends_nothing_it_warns_once_and_names_it(live, command):
    running = live("--duration", "12")
    silent = command("Twist", rate_hz=0)
    code, summary, err = ended(running)
    assert code == 0, err
    assert summary["commands"]["messages"] == 0
    (warned,) = (line for line in err.splitlines() if "no command within 5 s" in line)
    for answer in ("ros2:/cmd_vel", "geometry_msgs/Twist", f"process {silent.pid}", "no command yet"):
        assert answer in warned


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        (("run", "bring_up", "--controller", "ros2:cmd_vel"), "name of a ROS 2 topic"),
        (("live", "--controller", "ros2:/cmd_vel", "--command", "stdin"), "--command"),
        (("live", "--controller", "ros2:/cmd_vel", "--replay", "way.csv"), "--replay"),
        (("live", "--controller", "ros2:"), "name of a ROS 2 topic"),
        (("live", "--controller", "ros2:cmd vel"), "name of a ROS 2 topic"),
    ],
)
def test_what_cannot_be_meant_is_refused_before_anything_opens(
    words, answer, domain, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    (tmp_path / "way.csv").write_text("x,y,theta\n0,0,0\n0.05,0,0\n")
    assert main(list(words)) == 2
    assert answer in capsys.readouterr().err
    assert not any(tmp_path.rglob("*.mcap"))
