"""Observations of one cell: what the bench reported, and what the emulated robot truly did."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hil.bench import Held
from hil.core.errors import DeviceError, HilError, SafetyStop
from hil.core.geometry import Array


@dataclass(frozen=True)
class Ended:
    """An error that ended a drive, the opening or the closing of a bench.

    Attributes:
        text: the message.
        reason: reason of a safety stop; `device error` for a failed device; else the class of the error.
        suspects: names of the suspected devices.
    """

    text: str
    reason: str
    suspects: tuple[str, ...] = ()


def ended_by(error: HilError) -> Ended:
    """Convert an error to `Ended`, with the suspected devices from its data."""
    text = f"{type(error).__name__}: {error}"
    if isinstance(error, SafetyStop):
        return Ended(text, error.reason, error.suspects)
    if isinstance(error, DeviceError):
        return Ended(text, "device error", (error.device,))
    return Ended(text, type(error).__name__)


@dataclass
class Seen:
    """Observations of one run. World times in s, distances in m.

    Attributes:
        cycles: number of cycles.
        events: suspected devices of each event.
        stop: what ended the drive; None if it reached its end.
        error: error of opening or closing; None for none.
        foreign: an exception that is not from this project.
        unreadable: why the recording cannot be read.
        off_m, sigma_m: (2,) true error of the last estimate, and its standard deviation.
        held: final report of the bench, after its hold check; None if there is none.
        stopped_s, looked_s: time of the stop command, and of the final report.
        moved_m: true motion between these times; if the bench did not open, from the start position.
        crept_m: largest distance from there in the seconds after the bench has closed.
        fallen: whether the true robot fell at any time.
        adhesion_n, thrust_n: least true holding forces at any time, N.
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
        """State of the robot in the final report of the bench; empty without a report."""
        return "" if self.held is None else self.held.state
