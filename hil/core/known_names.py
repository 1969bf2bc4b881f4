"""Names that configuration, procedures and the command line let a user choose from.

They are separate from the code that they name, so that `--help` loads no numerical libraries.
"""

from typing import Literal, get_args

KINDS = ("servos", "encoders", "imu", "tracker", "mocap", "adhesion", "thrust", "load_cells")
"""Names of the kinds of devices that this package knows, in the order in which they are opened and read."""
EstimatorName = Literal["odometry", "ekf", "ukf"]
ESTIMATORS: tuple[EstimatorName, ...] = get_args(EstimatorName)
"""Estimators that can run in the loop."""
COMPARED = (*ESTIMATORS, "smoother")
"""Estimators that can process a recording afterwards."""
ALIGNMENTS = ("none", "origin", "se2")
"""Alignments of an estimate to the truth: none, by the first pose (yaw and position), least squares."""
LawName = Literal["nonlinear", "optimal"]
LAWS: tuple[LawName, ...] = get_args(LawName)
"""Control laws: the authors', and the time-varying LQR."""
METHODS = ("lm", "interior-point", "ga", "pso")
"""Solvers of a calibration."""

DistributionName = Literal["humble", "iron", "jazzy", "kilted", "lyrical", "rolling"]
"""Distributions of ROS 2."""
ROS2 = "ros2:"
"""Prefix of the name of a controller that runs on ROS 2; its topic follows."""
JOG = "jog:"
"""Prefix of the name of a controller by which an operator moves one joint; the servo's name follows."""
HIGHEST_DOMAIN = 101
"""Highest ROS 2 (DDS) domain whose ports stay below the ephemeral ports of Linux."""
