"""A program on ROS 2 drives a robot in virtual time: each cycle waits for its command."""

import json
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hil.core.errors import SafetyStop, UsageError
from hil.procedure.bench_source import BenchSource
from hil.recording.mcap_reader import read_cycles
from hil.recording.mcap_writer import McapRecorder
from hil.replay.recordings import open_recording
from hil.replay.verification import verify_recording
from hil.robot.trajectories import line

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
from hil.ros2.network import Network
from hil.ros2.publisher import Ros2Publisher

DRIVER = Path(__file__).with_name("driver.py")
TOPIC = "/joint_commands"
FOLLOWS = {"on": "states", "stamp": "copy", "follow": 120}
PATIENT = {"ros2.answer_timeout_s": 20.0, "ros2.start_timeout_s": 60.0}
HASTY = {"ros2.answer_timeout_s": 20.0, "ros2.start_timeout_s": 2.0}


@contextmanager
def driver(domain, settings, topic=TOPIC):
    begun = subprocess.Popen(
        [sys.executable, str(DRIVER), str(domain), topic, json.dumps(settings)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert begun.stdout.readline() == "begun\n"
        yield begun
    finally:
        begun.kill()
        begun.wait()
        begun.stdin.close()
        begun.stdout.close()


def drive(domain, path, overrides=PATIENT):
    """Motion along a line, recorded, and the bench afterwards."""
    publisher = Ros2Publisher(Network(domain), TOPIC)
    source = BenchSource(
        "emulated_floor", controller=f"ros2:{TOPIC}", publish=publisher.sink, overrides=overrides
    )
    try:
        with source.open() as bench:
            bench.add_sink(McapRecorder(path, bench.header(), lossless=True))
            end = (0.03, 0.0, 0.0)
            motion = bench.drive(
                line((0.0, 0.0, 0.0), end), start_pose=(0.0, 0.0, 0.0), hold_s=0.3, feedback="odometry"
            )
    finally:
        publisher.close()
    return motion, bench


def verdict(path):
    return verify_recording(open_recording(path))["verdict"]


def commands(path):
    return [c.external.commands for c in read_cycles(path) if c.external is not None]


def test_a_program_that_copies_stamps_drives_the_same_way_again(tmp_path, domain):
    ends = []
    for name in ("one.mcap", "two.mcap"):
        with driver(domain, FOLLOWS):
            motion, bench = drive(domain, tmp_path / name)
        ends.append(motion.records[-1].state.pose_body_in_wall.tobytes())
        assert abs(motion.records[-1].state.pose_body_in_wall[0] - 0.03) < 0.004
        assert not bench.warnings
    one, two = (commands(tmp_path / name) for name in ("one.mcap", "two.mcap"))
    assert all(len(found) == 1 for found in one)
    assert [c.velocity_rad_s.tolist() for (c,) in one] == [c.velocity_rad_s.tolist() for (c,) in two]
    assert ends[0] == ends[1]
    assert verdict(tmp_path / "one.mcap") == "identical"


@pytest.mark.parametrize(
    "settings", [{"stamp": "clock", "on": "clock"}, {"type": "Twist", "velocity": [0.0] * 6}]
)
def test_without_copied_stamps_a_run_is_said_to_be_only_synchronised(settings, tmp_path, domain):
    path = tmp_path / "r.mcap"
    with driver(domain, {**FOLLOWS, "follow": 0.0, **settings}):
        motion, bench = drive(domain, path)
    assert any("synchronised" in warning for warning in bench.warnings)
    answer = [e.message for r in motion.records for e in r.events if "synchronised" in e.message]
    assert len(answer) == 1
    assert verdict(path) == "identical"


STOPS = {
    "nan": ({**FOLLOWS, "after": 20, "then": {"follow": float("nan")}}, PATIENT, "ros2_command", "drive_FL"),
    "killed": (
        {**FOLLOWS, "limit": 20},
        {**PATIENT, "ros2.answer_timeout_s": 1.0},
        "ros2_lockstep",
        "cycle 20",
    ),
    "wall time": ({**FOLLOWS, "stamp": "wall"}, HASTY, "ros2_lockstep", "use_sim_time"),
    "best effort": ({**FOLLOWS, "best_effort": True}, HASTY, "ros2_lockstep", "quality of service"),
}


@pytest.mark.parametrize("case", STOPS)
def test_a_program_that_fails_stops_the_robot_by_name_and_replay_agrees(case, tmp_path, domain):
    settings, overrides, reason, answer = STOPS[case]
    path = tmp_path / "r.mcap"
    with driver(domain, settings), pytest.raises(SafetyStop, match=answer) as stop:
        drive(domain, path, overrides)
    assert stop.value.reason == reason
    last = list(read_cycles(path))[-1]
    assert not last.command.drive_velocity_rad_s.any()
    assert answer in last.events[-1].message
    assert verdict(path) == "identical"


def test_without_a_publisher_nothing_moves_and_it_says_where_it_looked(tmp_path, domain):
    with driver(domain, FOLLOWS, "/other"), pytest.raises(SafetyStop) as stop:
        drive(domain, tmp_path / "r.mcap", HASTY)
    for answer in (TOPIC, "sensor_msgs/JointState", f"domain {domain}", "LOCALHOST"):
        assert answer in str(stop.value)
    cycles = list(read_cycles(tmp_path / "r.mcap"))
    positions = np.array([c.inputs.servos[-1].position_rad for c in cycles if c.inputs.servos])
    assert np.ptp(positions, axis=0).max() < 0.01


def test_two_publishers_stop_the_robot(tmp_path, domain):
    with driver(domain, FOLLOWS), driver(domain, FOLLOWS), pytest.raises(SafetyStop) as stop:
        drive(domain, tmp_path / "r.mcap", PATIENT)
    assert stop.value.reason == "ros2_publishers"


def test_a_bench_in_another_process_is_refused(domain):
    source = BenchSource("emulated_floor", controller=f"ros2:{TOPIC}")
    with pytest.raises(UsageError, match="another process"):
        source.open()
