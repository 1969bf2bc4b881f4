"""The bench on ROS 2 without a ROS installation: the extra `ros2` speaks DDS, the protocol below ROS 2."""
