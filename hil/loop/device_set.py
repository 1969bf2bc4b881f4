"""All devices of a bench together: opened in order, read once per cycle, always closed."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

from hil.core.clock import Clock
from hil.core.errors import Aside, DeviceError
from hil.core.interfaces import Actuators, Device, Holding, Sensor
from hil.core.registry import kinds
from hil.core.signals import KINDS, Inputs
from hil.loop.checks.adhesion_limits import SlidePush
from hil.support.lost_time import LostTime

_SLOW_NS = 10_000_000
_NOTHING: tuple[Any, ...] = ()
_NONE_LOST: Mapping[str, int] = {}
_UNHEARD = {kind: _NOTHING for kind in KINDS if kind != "servos"}
"""Empty samples of each kind of sensor that this package knows, in the order of `Inputs`."""


@dataclass
class DeviceSet:
    """The devices of a bench.

    Attributes:
        clock: the bench clock.
        servos: driver of the servos; None where the bench has none.
        disarm: ends all faults in front of real devices; called first when the robot is stopped.
        sensors: the other devices by kind, in the order in which they are opened and read; devices that hold
            the robot (`DeviceKind.holds_robot`) are among them, and come first.
        lost: counts the time that this computer takes from the loop; None in virtual time.
        opening_ns: begin and end of each device's opening by the bench clock, ns; empty before it.
        lowered_n: set-point of propellers that were lowered against a slide, N; inf where they were not.
        aside: caller of what must not keep the robot from being held.
    """

    clock: Clock
    servos: Actuators | None = None
    sensors: Mapping[str, Sensor[Any]] = field(default_factory=dict)
    lost: LostTime | None = None
    disarm: Callable[[], None] = lambda: None
    lowered_n: float = math.inf
    opening_ns: dict[str, tuple[int, int]] = field(default_factory=dict)
    aside: Aside = field(default_factory=Aside)

    def get(self, kind: str) -> Any:
        """The device of a kind; None if the bench has none."""
        return self.sensors.get(kind, self.servos if kind == "servos" else None)

    def devices(self) -> tuple[Device, ...]:
        """Devices in order: those that hold the robot first, servos last: no motion before sensors answer."""
        return (*self.sensors.values(), *(() if self.servos is None else (self.servos,)))

    def open(self) -> None:
        """Open every device; on failure close those already open and raise the first error."""
        opened: list[Device] = []
        try:
            for device in self.devices():
                begin_ns = self.clock.now_ns()
                device.open()
                self.opening_ns[device.name] = begin_ns, self.clock.now_ns()
                opened.append(device)
        except BaseException:
            for device in reversed(opened):
                device.close()
            raise

    def close(self) -> None:
        """Close every device: servos first, devices that hold the robot last; a closed fan keeps running."""
        for device in reversed(self.devices()):
            device.close()
        if self.lost is not None:
            self.lost.close()

    def read(self, cycle: int) -> Inputs:
        """Read every device once, the others while the servos answer; `t_ns` is the time of the start."""
        now_ns = self.clock.now_ns
        t_ns = before_ns = now_ns()
        lost_ns = _NONE_LOST if self.lost is None else self.lost.take()
        servos, read, health = self.servos, _NOTHING, _NOTHING
        if servos is not None:
            servos.ask()
        known, slow_ns = _UNHEARD.copy(), {}
        added: dict[str, tuple[Any, ...]] = {}
        for kind, sensor in self.sensors.items():
            (known if kind in _UNHEARD else added)[kind] = sensor.read()
            done_ns = now_ns()
            if done_ns - before_ns > _SLOW_NS:
                slow_ns[kind] = self._slow_ns(done_ns - before_ns)
            before_ns = done_ns
        if servos is not None:
            read, health = servos.read(), servos.read_health()
            done_ns = now_ns()
            if done_ns - before_ns > _SLOW_NS:
                slow_ns["servos"] = self._slow_ns(done_ns - before_ns)
        values: tuple[Any, ...] = (cycle, t_ns, read, health, *known.values(), added, slow_ns, lost_ns)
        return Inputs(*values)

    def _slow_ns(self, took_ns: int) -> int:
        """Time that a device took to be read, without what this computer took meanwhile."""
        return took_ns if self.lost is None else max(0, took_ns - self.lost.so_far_ns())

    def brace(self) -> None:
        """Raise the force of all devices that hold the robot to the permitted maximum. Never raises."""
        for kind, device in self.sensors.items():
            if kinds()[kind].holds_robot:
                self.aside.call(kind, cast("Holding[Any]", device).brace)

    def push(self, push: SlidePush, *, falls: bool) -> str:
        """Command a force of the propellers against a slide. Never raises an exception.

        Propellers that were lowered against a slide push by more than is asked: they are not raised again. No
        push holds a robot that has come off.

        Args:
            push: set-point against the slide.
            falls: True if the accelerometer feels clearly less than the weight.

        Returns:
            Reason for which the propellers were not raised; empty if they were set.
        """
        propellers = self.get("thrust")
        if propellers is None:
            return ""
        if push.raises and (falls or math.isfinite(self.lowered_n)):
            return "the robot falls" if falls else "they were lowered against a slide before"
        force_n = min(push.force_n, self.lowered_n)
        if not push.raises:
            self.lowered_n = force_n
        self.aside.call("thrust", lambda: propellers.set_force_n(force_n))
        return ""

    def actuators(self) -> Actuators:
        """The servos. Raises `DeviceError` if the bench has none."""
        if self.servos is None:
            raise DeviceError(
                "servos", "the bench has no servos", remedy="add a [servos] section to the bench file"
            )
        return self.servos
