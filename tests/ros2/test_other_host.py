"""Another computer, as a network namespace with a route to this one, sees nothing unless it is asked in."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
from hil.ros2.network import Network
from hil.ros2.participant import Participant

pytestmark = [pytest.mark.real_time, pytest.mark.timeout(180)]
ONLOOKER = Path(__file__).with_name("onlooker.py")
NETWORK = f"10.213.{os.getpid() % 256}"
HERE, THERE = f"{NETWORK}.1", f"{NETWORK}.2"
LOOKS_S, LOOKS_AT_MOST_S = 5.0, 60.0
"""How long it looks for what must not be there, several announcements; and for what must."""


def ip(*words):
    try:
        done = subprocess.run(["ip", *words], capture_output=True, text=True, timeout=30)
    except FileNotFoundError:
        pytest.skip("this computer has no program ip (Debian package iproute2)")
    if done.returncode and "not permitted" in done.stderr + done.stdout:
        pytest.skip("network namespaces take the rights of root")
    assert done.returncode == 0, f"ip {' '.join(words)}: {done.stderr}"


@pytest.fixture
def other_host():
    """Name of a namespace and, of the cable to it, the interface on this side."""
    space, here = f"hil{os.getpid()}", f"hil{os.getpid() % 10**8}"
    ip("netns", "add", space)
    try:
        ip("link", "add", here, "type", "veth", "peer", "name", "cable", "netns", space)
        ip("addr", "add", f"{HERE}/24", "dev", here)
        ip("link", "set", here, "up")
        for words in (("addr", "add", f"{THERE}/24", "dev", "cable"), ("link", "set", "cable", "up")):
            ip("-n", space, *words)
        ip("-n", space, "route", "add", "default", "via", HERE)
        yield space, here
    finally:
        subprocess.run(["ip", "netns", "del", space], check=False)  # takes the cable along
        subprocess.run(["ip", "link", "del", here], check=False, capture_output=True)


def looking(space, domain, seconds):
    """Begins to look from the namespace: by multicast, and at this computer's ports by address."""
    configuration = (
        '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="cable"/></Interfaces>'
        "</General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
        "<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
        f'<Peers><Peer address="{HERE}"/></Peers><SPDPInterval>0.5s</SPDPInterval></Discovery>'
        "</Domain></CycloneDDS>"
    )
    words = [sys.executable, str(ONLOOKER), str(domain), str(seconds), configuration, "rt/joint_states"]
    return subprocess.Popen(["ip", "netns", "exec", space, *words], stdout=subprocess.PIPE, text=True)


@pytest.mark.parametrize("named", [False, True])
def test_it_sees_the_bench_only_where_the_interface_to_it_is_named(named, domain, other_host):
    """The second half shows that the first would see."""
    space, interface = other_host
    bench = Participant(Network(domain, interface if named else ""))
    try:
        bench.add_writer("/joint_states", "sensor_msgs/msg/JointState")
        bench.add_reader("/cmd_vel", "geometry_msgs/msg/Twist")
        onlooker = looking(space, domain, LOOKS_AT_MOST_S if named else LOOKS_S)
        try:
            out, _ = onlooker.communicate(timeout=120)
        finally:
            onlooker.kill()
    finally:
        bench.close()
    assert onlooker.returncode == 0
    seen = json.loads(out)
    expected = {"written": ["rt/joint_states"], "read": ["rt/cmd_vel"]}
    assert seen == (expected if named else {"written": [], "read": []})
