"""The motions of an odometry calibration: drives them on a bench and saves each as a CSV file."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hil.bench.loop_settings import motion_limits
from hil.core.clock import NS_PER_S
from hil.core.errors import DataError
from hil.core.geometry import Array, ArrayLike, rotation2
from hil.core.signals import KINDS
from hil.datasets.cleaning import Log
from hil.datasets.drive_coverage import covered
from hil.datasets.nominal_robot import Nominal
from hil.datasets.plain_csv import write_plain
from hil.datasets.wheel_log import Recording, build_recording
from hil.loop.driven_motion import Motion
from hil.procedure.needed_devices import leaving
from hil.procedure.scripted_joints import Stretch, play
from hil.procedure.tracking_errors import STAGGER_S, enable_hold
from hil.robot.kinematics import WheelGeometry, inverse
from hil.robot.motion_limits import slowed
from hil.robot.trajectories import Trajectory, circle, line

if TYPE_CHECKING:
    from hil.bench import Bench
    from hil.config.bench import BenchConfig

MotionName = Literal["line_x", "line_y", "circle_ccw", "circle_cw", "rotation_ccw", "rotation_cw"]
MOTIONS: tuple[MotionName, ...] = (
    "line_x",
    "line_y",
    "circle_ccw",
    "circle_cw",
    "rotation_ccw",
    "rotation_cw",
)
OTHER_MOTIONS = ("diagonal", "arc_ccw", "arc_cw")
"""Motions to validate a calibration with data that it was not fitted to."""
_SETTLE_S = 0.2
_APPROACH_RAD = 0.1
_FOLD_RAD = math.radians(5.0)
_ACCELERATION_M_S2 = 0.19
_SLOWED_AT_MOST = 1.1
"""Largest factor by which a turn is slowed down if fitted wheels stand further out than in the drawing."""


def unused() -> dict[str, object]:
    """Return bench overrides that leave out devices which calibration does not use."""
    return leaving(("servos", "mocap"), KINDS)


@dataclass(frozen=True)
class Sizes:
    """Size of the motions, and peak wheel speed."""

    line_m: float = 2.5
    radius_m: float = 0.5
    turns: float = 1.0
    speed_m_s: float = 0.118


@dataclass(frozen=True)
class Repetition:
    """Motions that are driven in sequence in one world.

    Attributes:
        folder: folder of the files `MOTION_K.csv`.
        number: K, counted from 1 over all rounds.
        part: index from 0, if a repetition is split over several worlds.
    """

    folder: Path
    motions: tuple[str, ...]
    number: int
    sizes: Sizes
    feedback: str = "odometry"
    hold_s: float = 1.0
    part: int = 0

    def file(self, motion: str) -> str:
        """Return the file name of a motion's recording."""
        return f"{motion}_{self.number}.csv"

    def halves(self) -> list[Repetition]:
        """Split the motions over two worlds, so that two processes share any number of repetitions evenly.

        Motions alternate between the parts: each part gets one of every pair that differs only in direction.
        """
        found = (self.motions[::2], self.motions[1::2])
        return [replace(self, motions=motions, part=k) for k, motions in enumerate(found) if motions]


def reference(name: str, start: ArrayLike, sizes: Sizes, *, backwards: bool = False) -> Trajectory:
    """Return a motion that begins at pose `start` (3,) m, m, rad; a line may be driven backwards."""
    pose = np.asarray(start, dtype=np.float64)
    sense = 1.0 if name.endswith("_ccw") else -1.0
    limits: dict[str, Any] = {"speed_m_s": sizes.speed_m_s, "acceleration_m_s2": _ACCELERATION_M_S2}
    if name.startswith("line"):
        step_m = np.array([sizes.line_m, 0.0] if name == "line_x" else [0.0, sizes.line_m])
        step_m = rotation2(float(pose[2])) @ step_m * (-1.0 if backwards else 1.0)
        return line(pose, pose + np.append(step_m, 0.0), name=name, **limits)
    if name == "diagonal":
        step_m = rotation2(float(pose[2])) @ np.full(2, math.sqrt(0.5) * sizes.line_m)
        return line(pose, pose + np.append(step_m * (-1.0 if backwards else 1.0), 0.0), name=name, **limits)
    if name.startswith("arc"):
        turns = 0.25 * sense * sizes.turns
        return circle(pose, 2.0 * sizes.radius_m, turns=turns, name=name, **limits)
    if name.startswith("circle"):
        return circle(pose, sizes.radius_m, turns=sense * sizes.turns, name=name, **limits)
    turn = np.array([0.0, 0.0, sense * 2.0 * math.pi * sizes.turns])
    return line(pose, pose + turn, name=name, **limits)


def followed(
    name: str,
    start: ArrayLike,
    sizes: Sizes,
    geometry: WheelGeometry,
    config: BenchConfig,
    *,
    backwards: bool = False,
) -> Trajectory:
    """Return `reference` from `start` (3,), slowed down slightly if this wheel geometry requires it.

    A fit may place the wheels further out than the drawing, so that a turn needs faster wheels. A speed
    that the configuration does not allow at all is not reduced, and is rejected later.
    """
    path, limits = reference(name, start, sizes, backwards=backwards), motion_limits(config)
    if sizes.speed_m_s > limits.wheel_speed_m_s:
        return path
    return slowed(path, geometry.projection(), limits, at_most=_SLOWED_AT_MOST)


def drive_repetition(
    bench: Bench, repetition: Repetition, written: Callable[[], object] = lambda: None
) -> None:
    """Drive all motions of a repetition and write their recordings; call `written` after each.

    The first rest is a little longer in every repetition and part, so that two worlds of one seed do not
    repeat each other's noise.
    """
    pose = enable_hold(bench, 0.5 + STAGGER_S * (repetition.number + 0.5 * repetition.part))
    backwards = repetition.number % 2 == 0
    for name in repetition.motions:
        take_up_play(bench, reference(name, pose, repetition.sizes, backwards=backwards), pose)
        pose = enable_hold(bench)
        path = followed(name, pose, repetition.sizes, bench.geometry, bench.config, backwards=backwards)
        motion = bench.drive(path, feedback=repetition.feedback, hold_s=repetition.hold_s, start_pose=pose)
        file = repetition.folder / repetition.file(name)
        file.parent.mkdir(parents=True, exist_ok=True)
        write_plain(file, recording_of(motion, file.stem, name))
        written()


def take_up_play(bench: Bench, trajectory: Trajectory, pose: Array) -> None:
    """Steer every wheel to the start angle of a motion from `pose` (3,), always from the same side.

    Otherwise a wheel may stand anywhere in the backlash of its gear. A random difference of an eighth of a
    degree between front and rear turns the robot by degrees over a few metres, differently in every round.

    Raises:
        DataError: a servo did not answer.
    """
    standing = bench.observe(_SETTLE_S, feedback="odometry", start_pose=pose).wheels[:, 4:]
    now = standing[np.all(np.isfinite(standing), axis=1)]
    if not len(now):
        raise DataError(trajectory.name, "has no complete servo readings", remedy="run bring_up")
    _, heading = inverse(bench.geometry, trajectory.sample(0.5 * trajectory.duration_s).twist_body)
    goal = np.mod(heading + 0.5 * math.pi - _FOLD_RAD, math.pi) - 0.5 * math.pi + _FOLD_RAD
    parts = (Stretch(0.8, steering_rad=goal - _APPROACH_RAD), Stretch(0.4, steering_rad=goal), Stretch(0.2))
    play(bench, parts, pose, now[-1])


def recording_of(motion: Motion, name: str, group: str) -> Recording:
    """Convert a driven motion to a calibration recording: wheels and ground truth on the bench clock.

    Raises:
        DataError: no usable wheel data, no ground truth, or no ground truth for a part of the drive.
    """
    origin_ns = motion.records[0].inputs.t_ns
    wheels = [w for r in motion.records for w in r.measurements.wheels if all(w.valid)]
    truth = [m for r in motion.records for m in r.measurements.mocap if m.valid]
    if not truth or not wheels:
        missing = "ground truth from motion capture" if wheels else "complete servo readings"
        raise DataError(name, f"has no {missing}", remedy="hil run bring_up")
    whole = build_recording(
        name,
        Log(
            _stamps([w.stamp.t_ns for w in wheels], origin_ns),
            np.array([np.r_[w.wheel_angle_rad, w.steering_rad, w.wheel_rate_rad_s] for w in wheels]),
        ),
        Log(_stamps([m.stamp.t_ns for m in truth], origin_ns), np.array([m.pose for m in truth])),
        motion=group,
    )
    return covered(whole, Nominal())


def _stamps(t_ns: Sequence[int], origin_ns: int) -> Array:
    return np.array([(t - origin_ns) / NS_PER_S for t in t_ns], dtype=np.float64)
