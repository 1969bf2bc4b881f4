"""Devices that are not believed any more in this run, because two others agree against them."""

from __future__ import annotations

from dataclasses import replace

from hil.ring.doubts import Doubt
from hil.vocabulary.signals import Event, Measurements

_MEASURED = {"tracker": "tracker", "imu": "gyro", "mocap": "mocap"}
"""Fields of `Measurements` by device."""


UNSHAKEN = (0.0, 0.0)


class LeftOut:
    """Of one run.

    Args:
        estimated: devices whose measurements the estimators use.
        on_wall: whether gravity pulls along the surface.

    Attributes:
        shaken: by how much the estimate may be off (m, rad), for what was found in this cycle.
    """

    def __init__(self, estimated: frozenset[str], *, on_wall: bool) -> None:
        self._estimated, self._on_wall = estimated, on_wall
        self.reset()

    def reset(self) -> None:
        """Believe everybody again."""
        self._names: set[str] = set()
        self.begin()

    def begin(self, off: tuple[float, float] = UNSHAKEN) -> None:
        """A new cycle; `off`: by how much the estimate may be off (m, rad) for other reasons."""
        self.shaken = off

    def __contains__(self, name: str) -> bool:
        return name in self._names

    def can_do_without(self, doubt: Doubt) -> bool:
        """Whether two others agree against a device, and are enough on this surface.

        On a wall all that the estimate uses has to remain: wheels do not see what the robot slides by, and
        only gravity says which way is up.
        """
        needed = self._on_wall and doubt.source in self._estimated
        return doubt.confirmed and doubt.source in _MEASURED and not needed

    def take(self, doubt: Doubt, t_ns: int) -> Event:
        """Believe the source of a doubt no more."""
        name = doubt.source
        self._names.add(name)
        if name in self._estimated:
            self.shake(doubt)
        return Event(t_ns, "warning", name, f"left out from now on: {doubt.message}")

    def shake(self, doubt: Doubt) -> None:
        """The estimate may be off by what two devices told differently."""
        off_m, off_rad = self.shaken
        self.shaken = (off_m, max(off_rad, doubt.off)) if doubt.turns else (max(off_m, doubt.off), off_rad)

    def believed(self, measurements: Measurements) -> Measurements:
        """Measurements without those of devices that were left out."""
        if not self._names:
            return measurements
        nothing: dict[str, tuple[()]] = {_MEASURED[name]: () for name in self._names}
        return replace(measurements, **nothing)  # type: ignore[arg-type]
