"""Cyclone DDS' own command line sees what the bench offers."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
from hil.ros2.network import Network
from hil.ros2.participant import Participant
from tests.ros2.listener import LOOPBACK

pytestmark = [pytest.mark.real_time, pytest.mark.timeout(180)]


def test_cyclonedds_ls_lists_the_topics_with_the_types_of_ros(domain):
    if importlib.util.find_spec("rich_click") is None:
        pytest.skip("`cyclonedds ls` needs the package rich_click, which is not installed")
    bench = Participant(Network(domain))
    try:
        for name, kind in (
            ("/joint_states", "sensor_msgs/msg/JointState"),
            ("/odom", "nav_msgs/msg/Odometry"),
        ):
            bench.add_writer(name, kind)
        bench.add_reader("/joint_commands", "sensor_msgs/msg/JointState")
        done = subprocess.run(
            [Path(sys.executable).with_name("cyclonedds"), "ls", "--id", str(domain), "--runtime", "8s"],
            capture_output=True,
            text=True,
            timeout=120,
            env={**os.environ, "CYCLONEDDS_URI": LOOPBACK, "COLUMNS": "200"},
        )
    finally:
        bench.close()
    assert done.returncode == 0, done.stderr
    for answer in ("rt/joint_states", "rt/odom", "rt/joint_commands", "sensor_msgs::msg::dds_::JointState_"):
        assert answer in done.stdout
