"""The state of the robot that the three-dimensional view shows, by the newest samples; no Rerun.

Truth is that of the emulated robot if the record carries it, else that of motion capture. Slip is the
emulated robot's own, else the measured motion minus the rolling of the wheels. Loads are the emulated robot's
own, else those of statics.
"""

import logging
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.core.clock import NS_PER_S
from hil.core.device import DeviceKind, Force
from hil.core.geometry import Array, between, se2_log
from hil.core.registry import further, kinds
from hil.core.signals import CycleRecord, Inputs
from hil.core.third_party_errors import PackageError, call_in_package
from hil.monitor import solid_geometry
from hil.monitor.scene import Scene

LOG = logging.getLogger(__name__)

_SLIP_WINDOW_NS = NS_PER_S // 2
_ASSUMED = {"adhesion": "fan", "thrust": "propeller"}
"""Kinds whose forces are assumed until they report, and the word in the names of assumed forces."""


@dataclass(frozen=True)
class Moment:
    """The robot at one time; None where nothing is known yet.

    Attributes:
        t_s, cycle: time and number of the cycle.
        pose: (3,) estimated, wall frame.
        covariance: (6, 6) covariance of the estimate.
        steering_rad, wheel_angle_rad: (4,) measured.
        truth, reference: (3,) poses in the wall frame.
        slip_m_s: (4, 2) along and across each wheel.
        load_n: (4,) normal loads.
        forces: forces on the robot, beside its weight and its wheels.
    """

    t_s: float
    cycle: int
    pose: Array
    covariance: Array
    steering_rad: Array
    wheel_angle_rad: Array
    truth: Array | None
    reference: Array | None
    slip_m_s: Array | None
    load_n: Array
    forces: tuple[Force, ...]


class Moments:
    """Keeps the newest known state of the robot.

    Args:
        scene: robot and surface.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._steering, self._wheel_angle = np.zeros(4), np.zeros(4)
        self._truth: Array | None = None
        self._reference: Array | None = None
        self._plant: Mapping[str, Any] = {}
        self._seen: deque[tuple[int, Array]] = deque()
        self._angles: deque[tuple[int, Array]] = deque()
        self._forces: dict[str, tuple[Force, ...]] = {}
        self._failing: set[str] = set()

    def note(self, record: CycleRecord) -> None:
        """Take what the scene shows of one cycle: wheels, true pose, forces."""
        self._note_wheels(record)
        self._note_truth(record)
        self._note_forces(record.inputs)

    def at(self, record: CycleRecord, t_s: float) -> Moment:
        """The robot at a cycle that has been noted.

        Args:
            record: record of the cycle; its pose is known.
            t_s: its time in the view.
        """
        pose = record.state.pose_body_in_wall
        return Moment(
            t_s,
            record.cycle,
            pose,
            record.state.covariance,
            self._steering,
            self._wheel_angle,
            self._truth,
            self._reference,
            self._slip(),
            self._loads(float(pose[2])),
            self._all_forces(),
        )

    def _note_wheels(self, record: CycleRecord) -> None:
        """Store the newest values of every wheel; a value that a servo did not report stays as it was."""
        for wheels in record.measurements.wheels[-1:]:
            self._steering = _known(wheels.steering_rad, self._steering)
            self._wheel_angle = _known(wheels.wheel_angle_rad, self._wheel_angle)
            self._angles.append((wheels.stamp.t_ns, self._wheel_angle))

    def _note_truth(self, record: CycleRecord) -> None:
        if record.truth is not None:
            self._plant = record.truth
            self._truth = np.asarray(self._plant["pose_body_in_wall"], dtype=np.float64)
        for mocap in record.measurements.mocap:
            if mocap.valid:
                self._seen.append((mocap.stamp.t_ns, mocap.pose))
                self._truth = self._truth if self._plant else mocap.pose
        for known in (self._seen, self._angles):
            while known and record.inputs.t_ns - known[0][0] > _SLIP_WINDOW_NS:
                known.popleft()
        if record.reference is not None:
            self._reference = record.reference.pose_in_wall

    def _note_forces(self, inputs: Inputs) -> None:
        known = kinds()
        for name in (*known, *further(inputs.added)):
            if name not in self._failing and (reported := self._forces_of(known[name], inputs)):
                self._forces[name] = reported

    def _forces_of(self, kind: DeviceKind, inputs: Inputs) -> tuple[Force, ...]:
        """Forces of a device kind; if its package raises, they are left out from then on, with a warning."""
        own = self._scene.devices.get(kind.name)
        try:
            return call_in_package(
                kind.name, kind.package, "forces", lambda: tuple(kind.forces(inputs, self._scene.robot, own))
            )
        except PackageError as error:
            self._failing.add(kind.name)
            LOG.warning("%s", error)
            return ()

    def _slip(self) -> Array | None:
        """The emulated robot's slip; else the mean over a window with known poses and wheel angles."""
        if self._plant:
            return np.asarray(self._plant["slip_m_s"], dtype=np.float64)
        if len(self._seen) < 2 or len(self._angles) < 2:
            return None
        angles_ns, angles = [t for t, _ in self._angles], np.stack([angle for _, angle in self._angles])
        inside = [(t, pose) for t, pose in self._seen if angles_ns[0] <= t <= angles_ns[-1]]
        if not inside or 2 * (inside[-1][0] - inside[0][0]) < _SLIP_WINDOW_NS:
            return None
        (begin_ns, begin), (end_ns, end) = inside[0], inside[-1]
        per_s = NS_PER_S / (end_ns - begin_ns)
        rolled = [np.diff(np.interp((begin_ns, end_ns), angles_ns, wheel))[0] for wheel in angles.T]
        return solid_geometry.slip_of_motion(
            se2_log(between(begin, end)) * per_s,
            np.array(rolled) * per_s,
            self._steering,
            self._scene.geometry,
        )

    def _loads(self, heading_rad: float) -> Array:
        if self._plant:
            return np.asarray(self._plant["normal_load_n"], dtype=np.float64)
        environment = self._scene.environment
        return self._scene.robot.wheel_loads_n(environment.tilt_rad, heading_rad, adheres=environment.on_wall)

    def _all_forces(self) -> tuple[Force, ...]:
        """Reported forces, and those assumed of fan or propellers while only the other one reports."""
        reported = tuple(force for forces in self._forces.values() for force in forces)
        assumed = assumed_forces(self._scene) if self._forces.keys() <= _ASSUMED.keys() else ()
        known = tuple(_ASSUMED[name] for name in self._forces) if assumed else ()
        return reported + tuple(force for force in assumed if not any(word in force.name for word in known))


def assumed_forces(scene: Scene) -> tuple[Force, ...]:
    """Forces of fan and propellers on a wall, by `[robot]`; none on a floor, where they are off."""
    robot = scene.robot
    if not scene.environment.on_wall:
        return ()
    found = [Force("fan (assumed)", np.zeros(3), np.array([0.0, 0.0, -robot.edf_force_n]))]
    for name, *force in robot.propellers(robot.weight_n * robot.thrust_compensation):
        found.append(Force(f"{name} (assumed)", *force))
    return tuple(force for force in found if math.hypot(*force.force_n) > 0.0)


def _known(new: Array, old: Array) -> Array:
    return np.where(np.isfinite(new), new, old)
