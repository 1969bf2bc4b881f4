"""A robot that repeats a recorded motion of a real robot and ignores all commands.

Joint angles are the recorded ones, interpolated. The body pose is the recorded ground truth, smoothed over
a quarter of a second; emulated IMU and camera measure its derivatives. Slip, loads and currents are unknown:
they are zero, equal shares of the weight, and zero.
"""

from dataclasses import dataclass

import numpy as np

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import DataError
from hil.core.geometry import Array
from hil.core.signals import SERVOS
from hil.fakes.body_interface import JointCommand, Plant, PlantState

_GRID_S = 0.005
_POSE_WINDOW, _JOINT_WINDOW, _ORDER = 51, 21, 3
_SHORTEST_S = 1.0
_EVEN_LOAD_N = 8.0
_JOINTS, _RATES, _POSE, _TWIST, _ACCELERATION = (
    slice(0, 8),
    slice(8, 16),
    slice(16, 19),
    slice(19, 22),
    slice(22, 24),
)


@dataclass(frozen=True)
class RecordedMotion:
    """Recorded motion of a robot.

    Attributes:
        name: name for messages.
        t_s: increasing stamps (n,); `pose_t_s` (m,) has the same zero.
        joint_rad: (n, 8) servo angles, order `hil.core.signals.SERVOS`.
        pose: (m, 3) body in wall: m, m, rad unwrapped.
    """

    name: str
    t_s: Array
    joint_rad: Array
    pose_t_s: Array
    pose: Array


class RecordedRobot(Plant):
    """Rests at the first pose, repeats the motion, and rests at the last pose.

    Args:
        motion: the recorded motion.
        tilt_rad: tilt of the surface.
        after_s: world time at which the motion begins.

    Raises:
        DataError: the recording is shorter than a second.
    """

    def __init__(self, motion: RecordedMotion, *, tilt_rad: float, after_s: float) -> None:
        self._tilt_rad, self._after_s = tilt_rad, after_s
        self._table = _tabulate(motion)
        self._t_ns = 0
        self._row = _at_rest(self._table[0])

    @property
    def t_ns(self) -> int:
        """Time up to which the motion has been replayed."""
        return self._t_ns

    def command(self, joint: int, command: JointCommand) -> None:
        """Ignore the command: the motion is recorded."""

    def advance(self, t_ns: int) -> None:
        """Replay up to `t_ns`."""
        if t_ns > self._t_ns:
            self._t_ns = t_ns
            self._row = self._at(t_ns)

    def _at(self, t_ns: int) -> Array:
        """Interpolate the table at a world time."""
        place = (t_ns - nanoseconds(self._after_s)) / NS_PER_S / _GRID_S
        last = len(self._table) - 1
        if place <= 0.0:
            return _at_rest(self._table[0])
        if place >= last:
            return _at_rest(self._table[last])
        before = int(place)
        low, high = self._table[before], self._table[before + 1]
        return np.asarray(low + (place - before) * (high - low), dtype=np.float64)

    def joints(self) -> tuple[Array, Array, Array]:
        """Return recorded angles (8,), rad, and rates (8,), rad/s; currents (8,), A, are unknown and zero."""
        return self._row[_JOINTS], self._row[_RATES], np.zeros(len(SERVOS))

    def truth(self) -> PlantState:
        """Return the recorded state at the present time."""
        row = self._row
        return PlantState(
            t_ns=self._t_ns,
            pose_body_in_wall=row[_POSE].copy(),
            twist_body=row[_TWIST].copy(),
            acceleration_body=row[_ACCELERATION].copy(),
            joint_position_rad=row[_JOINTS].copy(),
            joint_velocity_rad_s=row[_RATES].copy(),
            joint_current_a=np.zeros(len(SERVOS)),
            steering_true_rad=row[4:8].copy(),
            normal_load_n=np.full(4, _EVEN_LOAD_N),
            slip_m_s=np.zeros((4, 2)),
            tilt_rad=self._tilt_rad,
            fallen=False,
        )


def _at_rest(row: Array) -> Array:
    held: Array = row.copy()
    held[_RATES] = held[_TWIST] = held[_ACCELERATION] = 0.0
    return held


def _tabulate(motion: RecordedMotion) -> Array:
    """Resample the motion on an even grid, (k, 24): joints, rates, pose, twist, acceleration."""
    from scipy.signal import savgol_filter

    start_s = float(motion.t_s[0])
    grid_s = np.arange(start_s, float(motion.t_s[-1]), _GRID_S)
    if len(grid_s) * _GRID_S < _SHORTEST_S or len(motion.pose_t_s) < 2:
        raise DataError(
            motion.name,
            "is too short to be repeated",
            expected=f"at least {_SHORTEST_S:g} s with ground truth",
        )
    joints = _on_grid(grid_s, motion.t_s, motion.joint_rad)
    raw = _on_grid(grid_s, motion.pose_t_s, motion.pose)

    def smooth(values: Array, window: int, derivative: int) -> Array:
        return np.asarray(
            savgol_filter(values, window, _ORDER, deriv=derivative, delta=_GRID_S, axis=0), dtype=np.float64
        )

    pose, velocity, acceleration = (smooth(raw, _POSE_WINDOW, k) for k in range(3))
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])

    def in_body(vectors: Array) -> Array:
        return np.column_stack(
            [cos * vectors[:, 0] + sin * vectors[:, 1], cos * vectors[:, 1] - sin * vectors[:, 0]]
        )

    return np.column_stack(
        [
            joints,
            smooth(joints, _JOINT_WINDOW, 1),
            pose,
            in_body(velocity),
            velocity[:, 2],
            in_body(acceleration),
        ]
    )


def _on_grid(grid_s: Array, t_s: Array, values: Array) -> Array:
    return np.column_stack([np.interp(grid_s, t_s, column) for column in values.T])
