"""Names that configuration, procedures and the command line let a user choose from.

They are apart from what they name, so that `--help` does not wait for numerical libraries.
"""

from __future__ import annotations

from typing import Literal, get_args

EstimatorName = Literal["odometry", "ekf", "ukf"]
ESTIMATORS: tuple[EstimatorName, ...] = get_args(EstimatorName)
"""What can tell a running loop where the robot is."""
COMPARED = (*ESTIMATORS, "smoother")
"""What a recording can be run through afterwards."""
LawName = Literal["nonlinear", "optimal"]
LAWS: tuple[LawName, ...] = get_args(LawName)
"""Control laws: the authors', and the time-varying LQR."""
METHODS = ("lm", "interior-point", "ga", "pso")
"""Solvers of a calibration."""

DistributionName = Literal["humble", "iron", "jazzy", "kilted", "lyrical", "rolling"]
"""Distributions of ROS 2."""
ROS2 = "ros2:"
"""Begins the name of a controller that is a program on ROS 2; its topic follows."""
HIGHEST_DOMAIN = 101
"""Of the domains of ROS 2 (DDS): above it their ports run into those that Linux gives to any program."""
