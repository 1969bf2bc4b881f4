"""The seam between a bench and who keeps its fan, or its propellers, running."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Protocol

from hil.core.clock import Clock
from hil.core.finding import Finding
from hil.drivers.adhesion.keeper.client import Status, of_whom
from hil.drivers.adhesion.keeper.core import SetPoint
from hil.drivers.adhesion.keeper.spec import Spec


class Kept(Protocol):
    """A fan that goes on running whatever happens to the bench."""

    @abstractmethod
    def open(self) -> None:
        """Find or start who keeps it; a fan that runs goes on as it runs. Raises `DeviceError`."""

    @abstractmethod
    def set(self, point: SetPoint) -> None:
        """Another set-point; it is reached along a ramp. Raises `UsageError`, `DeviceError`."""

    @abstractmethod
    def end(self, confirmed_by: str) -> None:
        """Let the fan come to rest along the ramp; `confirmed_by` says why nothing can fall."""

    @abstractmethod
    def status(self) -> Status:
        """As the keeper's socket tells it: at least `state`, `sent`, `target`, `bus_error`."""

    @abstractmethod
    def trouble(self) -> str:
        """What is wrong with how the fan is kept; empty for nothing."""

    @abstractmethod
    def close(self) -> None:
        """Leave it to the keeper. The fan goes on. Idempotent; never raises."""


Keep = Callable[[Spec, Clock], Kept]
"""Makes who keeps a fan."""


_DOES = {
    "keeping": "keeps it running",
    "ending": "lets it come to rest",
    "idle": "it is at rest: nobody commands it until it is asked for",
}


def finding(name: str, kept: Kept | None) -> Finding:
    """What the doctor tells of who keeps a device running."""
    trouble = "it is closed" if kept is None else kept.trouble()
    status: Status = {} if kept is None else kept.status()
    does = _DOES[str(status.get("state", "idle"))] + (
        f"; it is one{other}" if (other := of_whom(status)) else ""
    )
    return Finding(
        name,
        "keeper",
        "warning" if trouble else "ok",
        trouble or does,
        "a process of its own",
        "`hil adhesion status` says more",
    )
