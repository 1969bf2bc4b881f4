"""Names and types of the ROS 2 topics of a recording."""

from collections.abc import Sequence

from hil.core.device import DeviceKind

TOPICS = {
    "/hil/cycle": "std_msgs/msg/UInt8MultiArray",
    "/hil/notes": "std_msgs/msg/String",
    "/hil/events": "rcl_interfaces/msg/Log",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/clock": "rosgraph_msgs/msg/Clock",
    "/robot_description": "std_msgs/msg/String",
    "/odom": "nav_msgs/msg/Odometry",
    "/reference": "geometry_msgs/msg/PoseStamped",
}
"""Topics that belong to no device, with their types."""


def topics_with(kinds: Sequence[DeviceKind]) -> dict[str, str]:
    """All topics of a recording with their types; those of a kind only if it is among `kinds`."""
    return {**TOPICS, **{topic.name: topic.type for kind in kinds for topic in kind.topics}}
