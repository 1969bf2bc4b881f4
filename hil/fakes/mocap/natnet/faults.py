"""Faults of the emulated capture server and of the network in front of it."""

import numpy as np

from hil.fakes.mocap.natnet.camera_view import SeenBody
from hil.faults.fault import IN, PERIODIC, Fault, Supported
from hil.faults.messages import FRAME_FAULTS, Messages, declared
from hil.faults.plan import DeviceFaults, FaultPlan

_OWN: Supported = {
    "off": (),
    "stuck": (),
    "garbage": ("nan", "packets"),
    "wrong": ("offset_m",),
    "slow": ("factor",),
    "delayed": ("delay_s",),
    "intermittent": (*PERIODIC, "occlude"),
    "unplug": (),
    "jump": (),
    "reset": (),
}
SUPPORTED_FAULTS = declared(_OWN, {}, FRAME_FAULTS)

_OFFSET_M = 0.1

Bodies = tuple[SeenBody, SeenBody]


class MocapFaults(DeviceFaults):
    """Faults of server and network.

    Options: `wrong,offset_m=` along x; `jump` exchanges the two bodies; `garbage` makes random poses,
    with `nan=1` NaN, with `packets=1` random packets; `slow,factor=`; `delayed,delay_s=`;
    `intermittent,period_s=,duty=` is silence, with `occlude=1` a hidden body. `off` and `reset` restart the
    server, `unplug` is the network cable.
    """

    def __init__(self, plan: FaultPlan, name: str, rng: np.random.Generator) -> None:
        super().__init__(plan, name, rng)
        self._frozen: Bodies | None = None
        self._messages = Messages(plan, (name,), rng, FRAME_FAULTS.keys() - _OWN.keys())
        plan.declare(name, SUPPORTED_FAULTS)

    def cut_off(self, t_ns: int) -> bool:
        """Return whether no packet is received or sent."""
        return self.find("off", t_ns) is not None or self.find("unplug", t_ns) is not None

    def silent(self, t_ns: int) -> bool:
        """Return whether this frame is not sent."""
        fault = self.find("intermittent", t_ns)
        return fault is not None and not fault.option("occlude", 0.0) and fault.silences(t_ns)

    def hidden(self, t_ns: int) -> bool:
        """Return whether the robot's body is hidden."""
        fault = self.find("intermittent", t_ns)
        return fault is not None and bool(fault.option("occlude", 0.0)) and fault.silences(t_ns)

    def distort(self, bodies: Bodies, t_ns: int) -> Bodies:
        """Apply `jump`, `wrong`, `garbage` and `stuck` to the measured bodies."""
        other, body = bodies
        if self.find("jump", t_ns) is not None:
            other, body = _at(other, body), _at(body, other)
        wrong = self.find("wrong", t_ns)
        if wrong is not None:
            x, y, z = body.position_m
            body = body._replace(position_m=(x + wrong.option("offset_m", _OFFSET_M), y, z))
        garbage = self.find("garbage", t_ns)
        if garbage is not None:
            body = self._garbage(body, garbage)
        if self.find("stuck", t_ns) is None:
            self._frozen = None
            return other, body
        self._frozen = self._frozen or (other, body)
        return self._frozen

    def received(self, packet: bytes, t_ns: int, way: str = IN) -> tuple[bytes, ...]:
        """Return the packets received for one sent: none, intact or damaged, once or twice."""
        garbage = self.find("garbage", t_ns) if way == IN else None
        if garbage is not None and garbage.option("packets", 0.0):
            packet = self._rng.bytes(len(packet))
        return self._messages.received(packet, t_ns, way)

    def _garbage(self, body: SeenBody, fault: Fault) -> SeenBody:
        bits = self._rng.integers(0, 256, 28, dtype=np.uint8)
        if fault.option("nan", 0.0):
            bits[:] = 255
        x, y, z, qx, qy, qz, qw = (float(v) for v in bits.view(np.float32))
        return body._replace(position_m=(x, y, z), rotation_xyzw=(qx, qy, qz, qw))


def _at(body: SeenBody, place: SeenBody) -> SeenBody:
    """Return a body with the pose and markers of another one."""
    return body._replace(
        position_m=place.position_m,
        rotation_xyzw=place.rotation_xyzw,
        markers_m=place.markers_m,
        tracked=place.tracked,
    )
