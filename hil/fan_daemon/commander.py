"""Interface between a driver and what commands its motor: the daemon process, or a daemon in a world."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Protocol

from hil.core.clock import Clock
from hil.core.finding import Finding
from hil.fan_daemon.client import Status, of_whom
from hil.fan_daemon.fan_control import SetPoint
from hil.fan_daemon.spec import Spec


class MotorCommander(Protocol):
    """Commands a motor, which goes on running whatever happens to the bench."""

    @abstractmethod
    def open(self) -> None:
        """Find or start the daemon; a motor that runs goes on as it runs. Raises `DeviceError`."""

    @abstractmethod
    def set(self, point: SetPoint) -> None:
        """Change the set-point; it is reached along a ramp. Raises `UsageError`, `DeviceError`."""

    @abstractmethod
    def end(self, confirmed_by: str) -> None:
        """Let the motor come to rest along the ramp; `confirmed_by` is the reason why nothing can fall."""

    @abstractmethod
    def status(self) -> Status:
        """The status as the daemon's socket gives it: at least `state`, `sent`, `target`, `bus_error`."""

    @abstractmethod
    def trouble(self) -> str:
        """The present fault in words; empty for none."""

    @abstractmethod
    def close(self) -> None:
        """Leave the motor to the daemon: it goes on. Idempotent; never raises."""


MakeCommander = Callable[[Spec, Clock], MotorCommander]
"""Makes the commander of a motor from (spec, clock)."""


_DOES = {
    "keeping": "keeps it running",
    "ending": "lets it come to rest",
    "idle": "it is at rest: no command is sent before a force is asked for",
}


def finding(name: str, commander: MotorCommander | None) -> Finding:
    """The doctor's finding on the daemon of a device."""
    trouble = "it is closed" if commander is None else commander.trouble()
    status: Status = {} if commander is None else commander.status()
    does = _DOES[str(status.get("state", "idle"))] + (
        f"; it is one{other}" if (other := of_whom(status)) else ""
    )
    return Finding(
        name,
        "daemon",
        "warning" if trouble else "ok",
        trouble or does,
        "a process of its own",
        "`hil adhesion status` says more",
    )
