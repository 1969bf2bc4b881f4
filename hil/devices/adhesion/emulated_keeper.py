"""The keeper of a fan that is emulated in this process: a part of its world, which outlives the bench.

On a robot the keeper is a process of its own. Where world and bench share a process no other could reach the
fan; so the keeper lives where the fan lives, and the fan goes on when the bench closes or forgets it.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from hil.core.clock import Clock, nanoseconds
from hil.core.errors import DeviceError
from hil.devices.emulated_can import on_can
from hil.devices.emulated_device import EmulatedDevice, EmulationRequest
from hil.drivers.adhesion.keeper.beat import Beat
from hil.drivers.adhesion.keeper.client import Status
from hil.drivers.adhesion.keeper.core import Keeper, SetPoint
from hil.drivers.adhesion.keeper.kept import Kept
from hil.drivers.adhesion.keeper.spec import Spec
from hil.fakes.can_channel import CanChannel, WorldBus
from hil.fakes.world import Scheduled, World

_LOG = logging.getLogger(__name__)


class Beginning(Protocol):
    """An emulated controller that may be at work when the bench comes."""

    def begin_in_use(self) -> None:
        """Be at work from the start."""


def kept_on_can(
    request: EmulationRequest,
    channel: CanChannel,
    nodes: Sequence[Beginning],
    *,
    subnet: int,
    dbc: Path | str,
    told: tuple[str, ...],
) -> EmulatedDevice:
    """Emulated controllers on a channel that a keeper commands; in this process it is one of their world.

    Args:
        request: where they are built.
        channel: their bus.
        nodes: the controllers; they begin in use with the bench.
        subnet: as of `on_can`.
        dbc: as of `on_can`.
        told: keys of the table that clients are told.
    """
    values = {key: getattr(request.config, key) for key in told}

    def begin_in_use() -> None:
        for node in nodes:
            node.begin_in_use()

    return on_can(
        request,
        channel,
        subnet=subnet,
        dbc=dbc,
        listens=True,
        told=values,
        parts={"keep": KeptInWorld(request.world).keep},
        begin=begin_in_use,
    )


class _LifelongBus(WorldBus):
    """A bus that a part of the world listens to for as long as the world lasts: nothing shuts it down."""

    def __del__(self) -> None:
        """Nothing is left open: it is memory of the world."""


class KeptInWorld(Kept, Scheduled):
    """A keeper that beats in world time.

    Args:
        world: of the fan.
    """

    tells = True

    def __init__(self, world: World) -> None:
        self._world = world
        self._beat: Beat | None = None
        self._period_ns = self._due_ns = 0

    def keep(self, spec: Spec, clock: Clock) -> Kept:
        """This keeper, for a driver of the fan; the first one says how it is kept."""
        if self._beat is None:
            self._beat = Beat(spec, Keeper(spec), _LOG.info)
            self._period_ns = nanoseconds(spec.period_s)
        self._spec = spec
        return self

    def open(self) -> None:
        """Begin to keep the fan, unless it is kept already."""
        if self._due_ns:
            return
        bus = _LifelongBus(self._spec.channel)
        self._beat = Beat(self._spec, Keeper(self._spec), _LOG.info, bus)
        self._due_ns = self._world.now_ns + 1
        self._world.add(self)

    def next_due_ns(self) -> int:
        """Time of the next command."""
        return self._due_ns

    def on_due(self, t_ns: int) -> None:
        """Listen, decide, send."""
        self._due_ns = t_ns + self._period_ns
        self._beating().beat(t_ns)

    def set(self, point: SetPoint) -> None:
        """As of a keeper."""
        self._beating().keeper.wish(self._world.now_ns, point)

    def end(self, confirmed_by: str) -> None:
        """As of a keeper."""
        _LOG.info("off, confirmed: %s", confirmed_by)
        self._beating().keeper.end(self._world.now_ns)

    def status(self) -> Status:
        """As of a keeper."""
        return self._beating().status(self._world.now_ns)

    def trouble(self) -> str:
        """What is wrong with the bus."""
        return self._beating().bus_error

    def close(self) -> None:
        """The fan goes on."""

    def _beating(self) -> Beat:
        if self._beat is None:
            raise DeviceError("adhesion", "nobody keeps the fan yet", remedy="open the device first")
        return self._beat
