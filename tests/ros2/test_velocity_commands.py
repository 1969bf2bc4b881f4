"""`hil live --controller ros2:TOPIC`: a program on ROS 2 drives the robot; what it may not do stops it."""

import signal
import time

import numpy as np
import pytest

from hil.recording.mcap_reader import read_cycles
from tests.ros2.test_joint_commands import PATIENCE_S, ended, verdict

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")

pytestmark = [
    pytest.mark.alone,
    pytest.mark.timeout(PATIENCE_S + 60),
    pytest.mark.usefixtures("warm_commands"),
]


@pytest.fixture
def moves(listen):
    """Until the loop of a live session runs, and its settling is over."""
    listener = listen("/joint_states")

    def wait():
        listener.matched()
        listener.has_heard()
        time.sleep(1.5)

    return wait


@pytest.mark.parametrize("kind", ["Twist", pytest.param("TwistStamped", marks=pytest.mark.long)])
def test_it_drives_as_commanded_and_not_before_and_rests_once_it_is_killed(
    kind, tmp_path, live, command, moves
):
    running = live("/cmd_vel")
    moves()
    program = command(kind, "linear.x=0.05", "angular.z=0.02")
    assert program.stdout.readline() == "matched\n"
    time.sleep(2.0)
    program.kill()
    time.sleep(1.5)
    running.send_signal(signal.SIGTERM)
    code, answer, err = ended(running)
    assert code == 4, err
    assert answer["commands"]["accepted"] > 20
    assert answer["commands"]["refused"] == 0
    assert answer["commands"]["dead_man_stops"] == 1
    assert answer["held"]["state"] in ("HELD", "not needed")
    cycles = [c for c in read_cycles(tmp_path / "r.mcap") if np.isfinite(c.state.covariance).all()]
    speeds = np.array([np.zeros(3) if c.reference is None else c.reference.twist_body for c in cycles])
    assert not speeds[-1].any()
    still = np.argmax(speeds.any(axis=1))
    assert still > 10, "at rest until the first command"
    rates = np.array([c.setpoint.wheel_rate_rad_s for c in cycles])
    assert np.abs(rates[:still]).max() < 0.2
    np.testing.assert_allclose(speeds[still:].max(axis=0), [0.05, 0.0, 0.02], atol=1e-12)
    assert cycles[-1].state.pose_body_in_wall[0] - cycles[still].state.pose_body_in_wall[0] > 0.02
    assert verdict(tmp_path / "r.mcap") == "identical"


def test_what_it_cannot_mean_stops_the_robot_by_name(tmp_path, live, command, listen):
    running = live("/cmd_vel", "--duration", "60")
    listener = listen("/joint_states")
    command("Twist", "linear.z=0.1")
    code, summary, _ = ended(running)
    _, gone_after_s = listener.heard()
    assert code == 3
    assert gone_after_s < 5.0, "it says goodbye: others do not take it for alive"
    assert "/cmd_vel" in summary["ended"]
    assert summary["held"]["state"] in ("HELD", "not needed")
    last = list(read_cycles(tmp_path / "r.mcap"))[-1]
    assert last.events[-1].message in summary["ended"]
    assert not last.setpoint.wheel_rate_rad_s.any()
    assert verdict(tmp_path / "r.mcap") == "identical"


def test_one_that_was_killed_and_comes_back_at_once_stops_the_robot_and_both_are_named(live, command, moves):
    running = live("/cmd_vel", "--duration", "60")
    moves()
    first = command("Twist", "linear.x=0.03")
    assert first.stdout.readline() == "matched\n"
    time.sleep(0.5)
    first.kill()
    second = command("Twist", "linear.x=0.03")
    code, summary, err = ended(running)
    assert code == 3, (summary, err)
    for answer in ("ros2_publishers", f"process {first.pid}", f"process {second.pid}", "for up to 10 s"):
        assert answer in summary["ended"]
    assert summary["held"]["state"] in ("HELD", "not needed")


@pytest.mark.long
def test_one_that_comes_back_after_its_lease_drives_again_and_the_loss_was_told(
    tmp_path, live, command, moves
):
    running = live("/cmd_vel")
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


def test_without_a_publisher_it_says_where_it_looked_and_which_other_type_it_found(live, command, domain):
    command("Header")
    code, summary, err = ended(live("/cmd_vel", "--duration", "8"))
    assert code == 0, err
    assert summary["commands"]["cycles"] == 0
    for answer in (
        "/cmd_vel",
        "geometry_msgs/TwistStamped",
        f"domain {domain}",
        "std_msgs::msg::dds_::Header_",
    ):
        assert answer in err


def test_of_a_publisher_that_sends_nothing_it_warns_once_and_names_it(live, command):
    running = live("/cmd_vel", "--duration", "12")
    silent = command("Twist", rate_hz=0)
    code, summary, err = ended(running)
    assert code == 0, err
    assert summary["commands"]["messages"] == 0
    (warned,) = (line for line in err.splitlines() if "no command within 5 s" in line)
    for answer in ("ros2:/cmd_vel", "geometry_msgs/Twist", f"process {silent.pid}", "no command yet"):
        assert answer in warned
