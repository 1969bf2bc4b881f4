"""The definitions of messages that come with the package are those of ROS 2, and all that are needed."""

from importlib import resources

import pytest
from rosbags.typesys import Stores, get_typestore

from hil.recording.mcap_file import definition
from hil.recording.ros_messages import topics_with
from hil.vocabulary.errors import ConfigError
from hil.vocabulary.kinds import kinds
from hil.vocabulary.reading import toml_tables
from hil.vocabulary.signals import KINDS

OURS = set(topics_with(tuple(kind for name, kind in kinds().items() if name in KINDS)).values())


def of_ros(kind):
    return get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(kind, ros_version=2)[0]


def test_every_type_of_our_own_topics_comes_with_the_package():
    file = resources.files("hil.recording").joinpath("message_definitions.toml")
    assert set(toml_tables(file.read_text(encoding="utf-8"), "definitions")) == OURS


@pytest.mark.parametrize("kind", [*sorted(OURS), "sensor_msgs/msg/Range"])
def test_a_definition_is_that_of_ros(kind):
    assert definition(kind) == of_ros(kind)


def test_a_type_that_ros_does_not_have_is_named():
    with pytest.raises(ConfigError, match="message type 'hil_msgs/msg/Nothing' cannot be recorded"):
        definition("hil_msgs/msg/Nothing")
