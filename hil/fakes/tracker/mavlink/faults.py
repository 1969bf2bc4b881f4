"""Faults of the emulated visual-inertial computer and of the network behind it."""

import dataclasses
import math

import numpy as np

from hil.fakes.tracker.mavlink.odometry import Estimate
from hil.fakes.tracker.wrong_poses import seen_drift_m, seen_scale
from hil.faults.fault import IN, Fault, Supported
from hil.faults.messages import FRAME_FAULTS, Messages, declared
from hil.faults.plan import DeviceFaults, FaultPlan

OWN_FAULTS: Supported = {
    "off": (),
    "stuck": (),
    "garbage": ("nan", "clock", "packets"),
    "wrong": ("scale", "drift_x_m_s", "drift_y_m_s", "quality", "frame"),
    "slow": ("factor",),
    "delayed": ("delay_s",),
    "jump": ("distance_m", "announced"),
    "reset": (),
}
"""Faults of the computer; a line or a network adds its own."""
SUPPORTED_FAULTS = declared(OWN_FAULTS, {"unplug": ()}, FRAME_FAULTS)
"""Faults of a computer behind a network."""

_JUMP_M = 0.1
_LATEST_US = 1 << 62


class ComputerFaults(DeviceFaults):
    """The active faults of computer and network.

    Options: `wrong,scale=` on every step, `wrong,quality=` in percent or `wrong,frame=` with a number of
    MAV_FRAME; `jump,distance_m=` once, with `announced=0` without a new reset count; `slow,factor=`;
    `delayed,delay_s=`; `garbage` makes random poses, with `nan=1` NaN, with `clock=1` random time stamps,
    with `packets=1` random packets. `off` and `reset` start it again, `unplug` is its cable.
    """

    def __init__(self, plan: FaultPlan, name: str, rng: np.random.Generator) -> None:
        super().__init__(plan, name, rng)
        self._frozen: Estimate | None = None
        self._messages = Messages(plan, (name,), rng, FRAME_FAULTS.keys() - OWN_FAULTS.keys())
        plan.declare(name, SUPPORTED_FAULTS)

    def silent(self, t_ns: int) -> bool:
        """Whether the computer sends nothing now."""
        return self.find("off", t_ns) is not None

    def cut_off(self, t_ns: int) -> bool:
        """Whether no packet gets in or out: the cable is unplugged."""
        return self.find("unplug", t_ns) is not None

    def jump(self, t_ns: int) -> tuple[float, bool]:
        """Distance of a jump that is due, once per fault, and whether the reset count shows it."""
        fault = self.first_activation("jump", t_ns)
        if fault is None:
            return 0.0, False
        return fault.option("distance_m", _JUMP_M), bool(fault.option("announced", 1.0))

    def scale(self, t_ns: int) -> float:
        """Factor on the steps seen."""
        return seen_scale(self.find("wrong", t_ns))

    def drift_m(self, t_ns: int, dt_s: float) -> tuple[float, float]:
        """False displacement (m, wall axes) that the odometry adds in a step."""
        return seen_drift_m(self.find("wrong", t_ns), dt_s)

    def distort(self, estimate: Estimate, t_ns: int) -> Estimate:
        """The estimate with the active faults applied."""
        if self.find("stuck", t_ns) is None:
            self._frozen = None
        else:
            self._frozen = self._frozen or estimate
            estimate = dataclasses.replace(self._frozen, time_us=estimate.time_us)
        wrong = self.find("wrong", t_ns)
        if wrong is not None:
            quality, frame = wrong.options.get("quality"), wrong.options.get("frame")
            estimate = dataclasses.replace(
                estimate,
                quality=estimate.quality if quality is None else int(quality),
                frame_id=estimate.frame_id if frame is None else int(frame),
            )
        garbage = self.find("garbage", t_ns)
        return estimate if garbage is None else self._garbage(estimate, garbage)

    def received(self, packet: bytes, t_ns: int, way: str = IN) -> tuple[bytes, ...]:
        """The datagrams that arrive for one that is sent: none, one or two, perhaps damaged."""
        return () if self.cut_off(t_ns) else self._messages.received(packet, t_ns, way)

    def scramble(self, packet: bytes, t_ns: int) -> bytes:
        """A packet as the computer sends it: random bytes under `garbage,packets=1`."""
        garbage = self.find("garbage", t_ns)
        if garbage is None or not garbage.option("packets", 0.0):
            return packet
        return self._rng.bytes(len(packet))

    def _garbage(self, estimate: Estimate, fault: Fault) -> Estimate:
        if fault.option("packets", 0.0):
            return estimate
        if fault.option("clock", 0.0):
            return dataclasses.replace(estimate, time_us=int(self._rng.integers(0, _LATEST_US)))
        values = [math.nan] * 13
        if not fault.option("nan", 0.0):
            values = [float(v) for v in self._rng.integers(0, 256, 52, dtype=np.uint8).view(np.float32)]
        return dataclasses.replace(
            estimate,
            position_m=tuple(values[:3]),
            quaternion_wxyz=tuple(values[3:7]),
            velocity_m_s=tuple(values[7:10]),
            rates_rad_s=tuple(values[10:]),
        )
