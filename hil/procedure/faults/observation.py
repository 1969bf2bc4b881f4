"""What was seen of one cell: by the bench, as kinds of devices that it accuses, and in truth."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hil.bench import Held
from hil.core.errors import DeviceError, HilError, SafetyStop
from hil.core.geometry import Array


@dataclass(frozen=True)
class Ended:
    """What ended a drive, the opening or the closing of a bench.

    Attributes:
        text: what was said.
        reason: of a stop; `device error` of a device that failed, else the class of the error.
        suspects: names of devices that it accuses.
    """

    text: str
    reason: str
    suspects: tuple[str, ...] = ()


def ended_by(error: HilError) -> Ended:
    """An error as what ended a cell, with whom it accuses by its data."""
    text = f"{type(error).__name__}: {error}"
    if isinstance(error, SafetyStop):
        return Ended(text, error.reason, error.suspects)
    if isinstance(error, DeviceError):
        return Ended(text, "device error", (error.device,))
    return Ended(text, type(error).__name__)


@dataclass
class Seen:
    """What was seen of a run. Times in s of the world, ways in m.

    Attributes:
        cycles: how many there were.
        events: the devices that each accuses.
        stop: what ended the drive; None where it came to its end.
        error: what opening and closing raised; None for nothing.
        foreign: an exception that is none of this project's.
        unreadable: what is wrong with the recording.
        off_m, sigma_m: (2,) true error of the last estimate, and its standard deviation.
        held: the bench's last word, after looking after the robot; None where it has none.
        stopped_s, looked_s: when the robot was asked to stop, and when that was said.
        moved_m: true way from the stop until then; of a bench that did not open, from where it stood.
        crept_m: farthest from there in the seconds after the bench has closed.
        fallen: the true robot, at any time.
        adhesion_n, thrust_n: least that truly held it at any time.
    """

    cycles: int = 0
    events: list[tuple[str, ...]] = field(default_factory=list)
    stop: Ended | None = None
    error: Ended | None = None
    foreign: str = ""
    unreadable: str = ""
    off_m: Array = field(default_factory=lambda: np.zeros(2))
    sigma_m: Array = field(default_factory=lambda: np.zeros(2))
    held: Held | None = None
    stopped_s: float = 0.0
    looked_s: float = 0.0
    moved_m: float = 0.0
    crept_m: float = 0.0
    fallen: bool = False
    adhesion_n: float = 1e3
    thrust_n: float = 1e3

    @property
    def state(self) -> str:
        """How the bench says that it left the robot; empty where it says nothing."""
        return "" if self.held is None else self.held.state
