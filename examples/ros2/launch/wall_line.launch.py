"""Starts the node `wall_line`: `ros2 launch wall_line wall_line.launch.py commands:=twist up_m:=0.5`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

DEFAULTS = {"commands": ("joints", str), "up_m": ("0.3", float), "across_m": ("0.0", float)}


def generate_launch_description() -> LaunchDescription:
    """The node with its parameters as arguments of the launch file."""
    arguments = [DeclareLaunchArgument(name, default_value=value) for name, (value, _) in DEFAULTS.items()]
    parameters = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, (_, kind) in DEFAULTS.items()
    }
    return LaunchDescription(
        [*arguments, Node(package="wall_line", executable="wall_line", parameters=[parameters])]
    )
