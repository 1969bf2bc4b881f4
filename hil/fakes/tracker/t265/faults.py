"""Faults of the emulated T265."""

import math

import numpy as np

from hil.fakes.tracker.t265.librealsense_frames import PoseFrame
from hil.fakes.tracker.visual_odometry import CameraPose, Quaternion, Vector
from hil.fakes.tracker.wrong_poses import seen_drift_m, seen_scale
from hil.faults.fault import Fault, Supported
from hil.faults.messages import ARRIVAL_FAULTS, Messages
from hil.faults.plan import DeviceFaults, FaultPlan

SUPPORTED_FAULTS: Supported = {
    "off": (),
    "stuck": (),
    "garbage": ("nan", "clock"),
    "wrong": ("scale", "drift_x_m_s", "drift_y_m_s", "confidence"),
    "slow": ("factor",),
    "delayed": ("delay_s",),
    "unplug": (),
    "jump": ("distance_m",),
    "reset": (),
    **ARRIVAL_FAULTS,
}

_JUMP_M = 0.1
_NAN = math.nan
_NO_VECTOR = Vector(_NAN, _NAN, _NAN)
_NOT_A_POSE = CameraPose(_NO_VECTOR, _NO_VECTOR, Quaternion(_NAN, _NAN, _NAN, _NAN), _NO_VECTOR)


class TrackerFaults(DeviceFaults):
    """Faults of the camera.

    Options: `wrong,scale=` on every step, `wrong,drift_x_m_s=,drift_y_m_s=` along the wall's axes, or
    `wrong,confidence=`; `jump,distance_m=` once; `slow,factor=`; `delayed,delay_s=`; `garbage,nan=1` for
    poses of NaN instead of random numbers, `garbage,clock=1` for random time stamps. `off` is silence, after
    which tracking starts anew; `unplug` ends the stream.
    """

    def __init__(self, plan: FaultPlan, name: str, rng: np.random.Generator) -> None:
        super().__init__(plan, name, rng)
        self._frozen: PoseFrame | None = None
        self._messages = Messages(plan, (name,), rng, ARRIVAL_FAULTS)
        plan.declare(name, SUPPORTED_FAULTS)

    @property
    def off(self) -> bool:
        """Whether the camera has no power."""
        return self._off

    def jump_m(self, t_ns: int) -> float:
        """Distance of a `jump` fault at its first query; else 0."""
        fault = self.first_activation("jump", t_ns)
        return 0.0 if fault is None else fault.option("distance_m", _JUMP_M)

    def scale(self, t_ns: int) -> float:
        """Return the factor of a `wrong` fault on the measured motion."""
        return seen_scale(self.find("wrong", t_ns))

    def drift_m(self, t_ns: int, dt_s: float) -> tuple[float, float]:
        """Return the additional motion that a `wrong` fault adds to a step, in the wall's axes."""
        return seen_drift_m(self.find("wrong", t_ns), dt_s)

    def spoil(self, frame: PoseFrame, t_ns: int) -> tuple[PoseFrame, ...]:
        """Return the frames received for one sent: none, intact or altered, once or twice."""
        if self.find("stuck", t_ns) is None:
            self._frozen = None
        else:
            self._frozen = self._frozen or frame
            frame = frame._replace(pose=self._frozen.pose, confidence=self._frozen.confidence)
        wrong = self.find("wrong", t_ns)
        if wrong is not None and "confidence" in wrong.options:
            frame = frame._replace(confidence=int(wrong.options["confidence"]))
        garbage = self.find("garbage", t_ns)
        if garbage is not None:
            frame = self._garbage(frame, garbage)
        return (frame,) * self._messages.copies(t_ns)

    def _garbage(self, frame: PoseFrame, fault: Fault) -> PoseFrame:
        if fault.option("clock", 0.0):
            return frame._replace(timestamp_ms=float(self._rng.uniform(0.0, 1e13)))
        if fault.option("nan", 0.0):
            return frame._replace(pose=_NOT_A_POSE)
        bits = self._rng.integers(0, 256, 52, dtype=np.uint8)
        values = [float(v) for v in bits.view(np.float32)]
        pose = CameraPose(
            Vector(*values[:3]), Vector(*values[3:6]), Quaternion(*values[6:10]), Vector(*values[10:])
        )
        return frame._replace(pose=pose, confidence=int(self._rng.integers(0, 4)))
