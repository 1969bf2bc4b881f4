"""Checks before a drive: the trajectory begins where the robot stands, and blind sensors are named."""

import math

import numpy as np

from hil.bench.loop_settings import pretended_holders
from hil.config.bench import BenchConfig
from hil.core.errors import TrajectoryError
from hil.core.geometry import Array, wrap
from hil.core.registry import kinds
from hil.core.signals import CycleRecord
from hil.robot.trajectories import Trajectory

_NEAR_M, _NEAR_RAD = 0.02, math.radians(5.0)
"""Tolerated start error of a robot placed by hand. The laws correct it with up to 5 m/s per metre, that is
with 0.1 m/s, below the largest commanded wheel speed (`control.wheel_speed_m_s`, 0.122 m/s)."""
_FEW = 3
"""Samples of motion capture that are compared: a robot that begins to move has gone a millimetre by then."""
_REMEDY = (
    "begin where it stands: in Python with start = hil.procedure.tracking_errors.enable_hold(bench) and "
    "line(start, ...), or put the robot there; where no motion capture sees it, say where it stands "
    "(--start x,y,theta)"
)


def must_begin_where_it_stands(trajectory: Trajectory, stands: Array) -> None:
    """Refuse a trajectory that begins elsewhere: the robot would drive straight there at full speed.

    Args:
        trajectory: trajectory to be followed.
        stands: (3,) initial pose of the estimate.

    Raises:
        TrajectoryError: the trajectory begins more than 20 mm or 5 degrees from that pose.
    """
    begins = trajectory.sample(0.0).pose_in_wall
    far_m = math.hypot(begins[0] - stands[0], begins[1] - stands[1])
    turned_rad = abs(wrap(float(begins[2] - stands[2])))
    near = far_m <= _NEAR_M
    if near and turned_rad <= _NEAR_RAD:
        return
    raise TrajectoryError(
        f"{trajectory.name}: it begins at {_pose_text(begins)}, the robot stands at {_pose_text(stands)}",
        t_s=0.0,
        quantity="angle between them (rad)" if near else "distance between them (m)",
        value=turned_rad if near else far_m,
        limit=_NEAR_RAD if near else _NEAR_M,
        remedy=_REMEDY,
    )


class StartWatch:
    """Compares the pose at which a drive is said to begin with motion capture, in its first cycles.

    Args:
        said: (3,) pose in the wall frame.
    """

    def __init__(self, said: Array) -> None:
        self._said = said
        self._seen: list[Array] = []

    def found(self, record: CycleRecord) -> str:
        """Warning, once, if motion capture sees the robot elsewhere; else empty."""
        if len(self._seen) >= _FEW:
            return ""
        self._seen += [one.pose for one in record.measurements.mocap if one.valid]
        if len(self._seen) < _FEW:
            return ""
        seen = np.median(self._seen, axis=0)
        far_m = math.hypot(*(seen[:2] - self._said[:2]))
        turned_rad = abs(wrap(float(seen[2] - self._said[2])))
        if far_m <= _NEAR_M and turned_rad <= _NEAR_RAD:
            return ""
        return (
            f"motion capture sees the robot at {_pose_text(seen)}, {1e3 * far_m:.0f} mm and "
            f"{math.degrees(turned_rad):.1f} deg from its start pose, {_pose_text(self._said)}: either the "
            "start pose is wrong, or its world has moved; look at environment.start_pose (--start), at its "
            "origin and at mocap.body"
        )


def blind_to_the_drive(config: BenchConfig) -> str:
    """Warning about sensors of this bench that do not see the robot drive; empty if all do."""
    found = kinds()
    blind = [found[name].noun for name in config.elsewhere() if found[name].motion_threshold]
    if not blind:
        return ""
    return (
        f"{', '.join(blind)}: in another world than the servos (emulated beside real ones, or the reverse), "
        "so they do not see the robot move. A drive whose estimate needs one of them ends in a SafetyStop "
        "(sensors_disagree), and none shows whether the robot is held. Emulate only devices that do not "
        "see it move, emulate the servos as well, or drive by odometry"
    )


def emulated_hold(config: BenchConfig) -> str:
    """Warning if devices that hold a real robot on its wall are emulated; else empty."""
    holders = pretended_holders(config)
    if not holders:
        return ""
    return (
        f"{', '.join(kinds()[name].noun for name in holders)}: emulated beside real servos, so the "
        "real robot gets nothing from there that holds it on its wall. Do not emulate what holds a real robot"
    )


def forces_apart(config: BenchConfig) -> str:
    """Warning if fan and load cells are in two worlds, so that neither confirms the other; else empty."""
    name = config.force_sensor_elsewhere()
    if not name:
        return ""
    return (
        f"{kinds()[name].noun}: in another world than the servos (emulated beside real ones, or the "
        "reverse), so the force measured there is that of another robot: it is neither compared nor counted, "
        "and the force that holds this robot is unconfirmed"
    )


def _pose_text(pose: Array) -> str:
    x_m, y_m, heading_rad = pose.tolist()
    return f"x {x_m:.3f} m, y {y_m:.3f} m, theta {heading_rad:.3f} rad"
