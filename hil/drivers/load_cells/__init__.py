"""Load cells that measure with which force the fan presses the robot on its surface."""
