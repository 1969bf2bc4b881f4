"""Runs the daemon of a fan that is emulated in this process, as a part of its world.

On a robot the daemon is a process of its own. Where world and bench share a process, no other process could
reach the fan; so the daemon is part of the world, and the fan goes on when the bench closes or drops it.
"""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from hil.core.clock import Clock, nanoseconds
from hil.core.errors import DeviceError
from hil.fakes.can_channel import CanChannel, WorldBus
from hil.fakes.emulated_can import on_can
from hil.fakes.emulated_device import EmulatedDevice, EmulationRequest
from hil.fakes.world import Scheduled, World
from hil.fan_daemon.bus_cycle import BusCycle
from hil.fan_daemon.client import Status
from hil.fan_daemon.commander import MotorCommander
from hil.fan_daemon.fan_control import FanControl, SetPoint
from hil.fan_daemon.spec import Spec

_LOG = logging.getLogger(__name__)


class Beginning(Protocol):
    """An emulated controller that can be running when the bench opens."""

    def begin_in_use(self) -> None:
        """Run from the start."""


def commanded_on_can(
    request: EmulationRequest,
    channel: CanChannel,
    nodes: Sequence[Beginning],
    *,
    subnet: int,
    dbc: Path | str,
    printed: tuple[str, ...],
) -> EmulatedDevice:
    """Emulated controllers on a channel, commanded by a daemon in their world.

    Args:
        request: the world and the table of the bench file.
        channel: their bus.
        nodes: the controllers; they begin in use with the bench.
        subnet: third byte of the multicast group, as in `on_can`.
        dbc: path for clients, as in `on_can`.
        printed: keys of the table that are printed for clients.
    """
    values = {key: getattr(request.config, key) for key in printed}

    def begin_in_use() -> None:
        for node in nodes:
            node.begin_in_use()

    return on_can(
        request,
        channel,
        subnet=subnet,
        dbc=dbc,
        listens=True,
        printed=values,
        parts={"make_commander": DaemonInWorld(request.world).commander},
        begin=begin_in_use,
    )


class _LifelongBus(WorldBus):
    """A bus that stays open as long as its world lasts: nothing shuts it down."""

    def __del__(self) -> None:
        """Suppress the warning of a bus that was not shut down: this one is memory of the world."""


class DaemonInWorld(MotorCommander, Scheduled):
    """A daemon that sends in world time.

    Args:
        world: world of the fan.
    """

    announces = True

    def __init__(self, world: World) -> None:
        self._world = world
        self._cycle: BusCycle | None = None
        self._period_ns = self._due_ns = 0

    def commander(self, spec: Spec, clock: Clock) -> MotorCommander:
        """This daemon, for a driver of the fan; the first driver's `spec` sets the period."""
        if self._cycle is None:
            self._cycle = BusCycle(spec, FanControl(spec), _LOG.info)
            self._period_ns = nanoseconds(spec.period_s)
        self._spec = spec
        return self

    def open(self) -> None:
        """Start to command the fan, unless already started."""
        if self._due_ns:
            return
        bus = _LifelongBus(self._spec.channel)
        self._cycle = BusCycle(self._spec, FanControl(self._spec), _LOG.info, bus)
        self._due_ns = self._world.now_ns + 1
        self._world.add(self)

    def next_due_ns(self) -> int:
        """Time of the next command."""
        return self._due_ns

    def on_due(self, t_ns: int) -> None:
        """Run one cycle of the daemon: receive, decide, send."""
        self._due_ns = t_ns + self._period_ns
        self._bus_cycle().step(t_ns)

    def set(self, point: SetPoint) -> None:
        """Change the set-point along the ramp."""
        self._bus_cycle().control.set_target(self._world.now_ns, point)

    def end(self, confirmed_by: str) -> None:
        """Let the fan come to rest along the ramp."""
        _LOG.info("off, confirmed: %s", confirmed_by)
        self._bus_cycle().control.end(self._world.now_ns)

    def status(self) -> Status:
        """The state of control, fan and bus."""
        return self._bus_cycle().status(self._world.now_ns)

    def trouble(self) -> str:
        """The fault of the bus, or a battery that sags; empty for none."""
        cycle = self._bus_cycle()
        return cycle.bus_error or cycle.control.trim.sag

    def close(self) -> None:
        """Do nothing: the fan goes on with its world."""

    def _bus_cycle(self) -> BusCycle:
        if self._cycle is None:
            raise DeviceError("adhesion", "no daemon commands the fan yet", remedy="open the device first")
        return self._cycle
