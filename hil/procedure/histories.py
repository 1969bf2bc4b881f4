"""What the report of a run shows by itself of its benches: path, holding force, own devices, sensor fits."""

from __future__ import annotations

from dataclasses import dataclass, field

from hil.core.interfaces import Sink
from hil.procedure.fit_history import FitHistory
from hil.report.device_history import DeviceHistory
from hil.report.holding_force_history import HoldHistory
from hil.report.path_history import PathHistory


@dataclass(frozen=True)
class Histories:
    """Histories of the benches of a run, or of one bench that another process drives.

    Attributes:
        hold, path, devices: values of the figures.
        fit: values of the table of sensor fits.
    """

    hold: HoldHistory = field(default_factory=HoldHistory)
    path: PathHistory = field(default_factory=PathHistory)
    devices: DeviceHistory = field(default_factory=DeviceHistory)
    fit: FitHistory = field(default_factory=FitHistory)

    def sinks(self, *, drawn: bool = True) -> tuple[Sink, ...]:
        """Sinks for a bench; `drawn` is False where no figures will be drawn."""
        return (self.fit, self.hold, self.path, self.devices) if drawn else (self.fit,)

    def follow(self, later: Histories) -> None:
        """Append the histories of benches that were driven in another process."""
        self.hold.follow(later.hold)
        self.path.follow(later.path)
        self.devices.follow(later.devices)
        self.fit.follow(later.fit)
