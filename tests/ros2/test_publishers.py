"""Who publishes a topic of commands: programs that come, end, or are killed."""

import time

import pytest

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
from cyclonedds.sub import DataReader

from hil.ros2.command_topic import CommandTopic
from hil.ros2.network import Network
from hil.ros2.participant import Participant

pytestmark = pytest.mark.timeout(180)
TWIST = "geometry_msgs/msg/Twist"
PATIENCE_S = 60.0


@pytest.fixture
def topic(domain):
    participant = Participant(Network(domain))
    topic = CommandTopic(participant, "/cmd_vel")
    yield topic
    topic.close()
    participant.close()


def taken_until(topic, over):
    """All messages that come until something holds."""
    messages, until = [], time.monotonic() + PATIENCE_S
    while not over():
        assert time.monotonic() < until
        topic.wait(20_000_000)
        messages += topic.take()
    return messages + topic.take()


def has(topic, count):
    return lambda: len(topic.publishers()) == count


@pytest.mark.parametrize("ends", ["by itself", pytest.param("killed", marks=pytest.mark.long)])
def test_the_topic_is_read_on_after_its_publisher_is_gone_and_when_one_comes_back(ends, topic, command):
    for _ in range(2):
        program = command("Twist", "lease=2")
        assert taken_until(topic, lambda: any(topic.silent_s(one) is not None for one in topic.publishers()))
        if ends == "killed":
            program.kill()
        else:
            program.stdin.close()
        last = taken_until(topic, has(topic, 0))
        assert {kind for kind, _ in last} <= {TWIST}
        assert all(data for _, data in last)
        assert topic.take() == []


def test_a_publisher_that_is_found_while_they_are_counted_is_counted(topic, command, monkeypatch):
    """Cyclone's binding asks for the number, then for the handles: one more by then was an IndexError."""
    command("Twist"), command("Twist")
    taken_until(topic, has(topic, 2))
    counts, count = [], DataReader._get_matched_publications

    def one_less_at_first(self, reader, handles, room):
        found = count(self, reader, handles, room)
        if found:
            counts.append(found)
        return found - (len(counts) == 1) if found else found

    monkeypatch.setattr(DataReader, "_get_matched_publications", one_less_at_first)
    assert len(topic.publishers()) == 2
    assert len(counts) > 2, "it was asked again"


def test_of_two_the_one_that_sends_and_the_one_that_never_did_are_told_apart(topic, command):
    speaks, silent = command("Twist"), command("Twist", rate_hz=0)
    taken_until(topic, lambda: has(topic, 2)() and any(map(topic.silent_s, topic.publishers())))
    assert topic.several_message().startswith("/cmd_vel has 2 publishers")
    silent_s = {one.program: topic.silent_s(one.handle) for one in topic.described()}
    assert silent_s[f"process {silent.pid}"] is None
    assert silent_s[f"process {speaks.pid}"] < PATIENCE_S
