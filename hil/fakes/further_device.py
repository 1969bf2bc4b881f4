"""The world as a further emulated device of a kind sees it: its faults and random numbers are its own.

Chips call themselves by the name of their kind. Here that name means the device on the bench: a fault of
`rangefinder_rear` strikes the chip that asks for faults of `rangefinder`.
"""

from __future__ import annotations

from collections.abc import Container
from typing import Any, cast

import numpy as np

from hil.fakes.active_faults import FaultPlan, FaultsOf
from hil.fakes.fault import Fault, Supported
from hil.fakes.world import World


def world_of(world: World, kind: str, name: str) -> World:
    """A world for one device.

    Args:
        world: of the bench.
        kind: by whose name its chip calls itself.
        name: of the device on the bench.
    """
    return world if name == kind else cast("World", _WorldOf(world, kind, name))


class _WorldOf:
    """A world whose faults and random streams are those of one device."""

    def __init__(self, world: World, kind: str, name: str) -> None:
        self._world, self._name = world, name
        self.faults = _FaultsIn(world.faults, kind, name)

    def rng(self, stream: str) -> np.random.Generator:
        """A stream of the device's own."""
        return self._world.rng(f"{self._name}: {stream}")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._world, name)


class _FaultsIn:
    """A plan of faults in which the names of a kind are those of one device."""

    def __init__(self, plan: FaultPlan, kind: str, name: str) -> None:
        self._plan, self._kind, self._name = plan, kind, name

    def _own(self, device: str) -> str:
        """The kind's name, and that of a part: `encoders` and `encoder.FL`."""
        head, dot, part = device.partition(".")
        heads = (self._kind, self._kind.removesuffix("s")) if dot else (self._kind,)
        return self._name + dot + part if head in heads else device

    def of(self, *names: str) -> FaultsOf:
        """As of the plan."""
        return self._plan.follow(FaultsOf(cast("FaultPlan", self), tuple(map(self._own, names))))

    def declare(self, device: str, supported: Supported) -> None:
        """As of the plan."""
        self._plan.declare(self._own(device), supported)

    def find(self, device: str, kind: str, t_ns: int) -> Fault | None:
        """As of the plan."""
        return self._plan.find(self._own(device), kind, t_ns)

    def active(self, device: str, t_ns: int) -> tuple[Fault, ...]:
        """As of the plan."""
        return self._plan.active(self._own(device), t_ns)

    def acting(self, devices: Container[str], t_ns: int) -> bool:
        """As of the plan; its names are the device's own already."""
        return self._plan.acting(devices, t_ns)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plan, name)
