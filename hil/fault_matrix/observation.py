"""Observations of one cell: what the bench reported, and what the emulated robot truly did."""

import re
from dataclasses import dataclass, field

import numpy as np

from hil.bench import Held
from hil.core.errors import ConfigError, DeviceError, HilError, SafetyStop
from hil.core.geometry import Array
from hil.core.registry import kinds


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
    named = isinstance(error, ConfigError)  # by the keys of their tables
    keys = tuple(name for name in kinds() if named and re.search(rf"\b{name}\.", text))
    return Ended(text, type(error).__name__, keys)


@dataclass(frozen=True)
class Told:
    """Content of one event.

    Attributes:
        suspects: names of the suspected devices.
        text: the message.
    """

    suspects: tuple[str, ...]
    text: str = ""


@dataclass(frozen=True)
class Figures:
    """The end of the drive as the bench measured it and as it truly was: distances from the goal, m.

    Attributes:
        said_m: distance that the bench reports; NaN where it reports none.
        true_m: true distance.
        marked: True if the bench marks its figure, because a sensor was left out.
    """

    said_m: float
    true_m: float
    marked: bool = False


@dataclass
class Seen:
    """Observations of one run. World times in s, distances in m.

    Attributes:
        cycles: number of cycles.
        on_wall: True if gravity truly pulls along the surface.
        events: events of the drive, and of what ended it.
        stop: error that ended the drive; None if it reached its end.
        error: error of opening or closing; None for none.
        foreign: an exception that is not from this project.
        unreadable: reason why the recording cannot be read.
        astray_m: largest true distance from the reference during the drive.
        effect_m: largest true distance from a run of the same world without a fault, during the drive.
        figures: the end of the drive; None if the run did not reach it.
        off_m, sigma_m: (2,) true error of the last estimate, and its standard deviation.
        held: final report of the bench, after its hold check; None if there is none.
        stopped_s, looked_s: time of the stop command, and of the final report.
        moved_m: true motion between these times; if the bench did not open, from the start position.
        crept_m: largest distance from there in the seconds after the bench has closed.
        fallen: True if the true robot fell at any time.
        at_links: True if the faults were injected at links, and ended before the robot was judged.
        missed: specs of faults that hit no message or did not begin.
        adhesion_n, thrust_n: least true holding forces at any time, N.
        held_adhesion_n: true force of the fan at the final report, N.
        left_adhesion_n: true force of the fan at the end of the observation, N.
        most_thrust_n: largest true push of the propellers after the bench has closed, N.
    """

    cycles: int = 0
    on_wall: bool = True
    events: list[Told] = field(default_factory=list)
    stop: Ended | None = None
    error: Ended | None = None
    foreign: str = ""
    unreadable: str = ""
    astray_m: float = 0.0
    effect_m: float = 0.0
    figures: Figures | None = None
    off_m: Array = field(default_factory=lambda: np.zeros(2))
    sigma_m: Array = field(default_factory=lambda: np.zeros(2))
    held: Held | None = None
    stopped_s: float = 0.0
    looked_s: float = 0.0
    moved_m: float = 0.0
    crept_m: float = 0.0
    fallen: bool = False
    at_links: bool = False
    missed: str = ""
    adhesion_n: float = 1e3
    thrust_n: float = 1e3
    held_adhesion_n: float = 45.0
    left_adhesion_n: float = 45.0
    most_thrust_n: float = 0.0

    @property
    def state(self) -> str:
        """State of the robot in the final report of the bench; empty without a report."""
        return "" if self.held is None else self.held.state
