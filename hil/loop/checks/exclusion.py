"""Excludes devices for the rest of a run when two others agree against them."""

from dataclasses import replace

from hil.core.signals import Event, Measurements
from hil.loop.checks.cusum import Disagreement
from hil.loop.cycle_data import Cycle

_MEASURED = {"tracker": "tracker", "imu": "gyro", "mocap": "mocap"}
"""Fields of `Measurements` by device."""


class Exclusion:
    """The devices of one run whose measurements are not believed.

    Args:
        estimated: devices whose measurements the estimators use.
        on_wall: True if gravity pulls along the surface.
    """

    def __init__(self, estimated: frozenset[str], *, on_wall: bool) -> None:
        self._estimated, self._on_wall = estimated, on_wall
        self.reset()

    def reset(self) -> None:
        """Clear the exclusions."""
        self._names: set[str] = set()
        self._moved: set[str] = set()

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def can_do_without(self, doubt: Disagreement) -> bool:
        """Whether two others agree against a device, and are sufficient on this surface.

        On a wall the estimate needs all its sensors: wheels do not detect a slide, and only gravity gives the
        vertical.
        """
        needed = self._on_wall and doubt.source in self._estimated
        return doubt.confirmed and doubt.source in _MEASURED and not needed

    def take(self, doubt: Disagreement, cycle: Cycle) -> None:
        """Exclude the source of a disagreement, and report it."""
        name = doubt.source
        self._names.add(name)
        if name in self._estimated:
            cycle.inflate(*doubt.inflation)
        said = f"left out from now on: {doubt.message}"
        cycle.events.append(
            Event(
                cycle.inputs.t_ns, "warning", name, said, distrusts=True, key=doubt.key, factor=doubt.factor
            )
        )

    def take_moved(self, name: str, message: str, cycle: Cycle) -> None:
        """Report that the frame of a device has moved.

        Its displacements still count in comparisons with others, its positions for nothing, unless the
        estimators use them and judge them themselves.
        """
        independent = name not in self._estimated
        if independent:
            self._moved.add(name)
        cycle.events.append(Event(cycle.inputs.t_ns, "warning", name, message, distrusts=independent))

    def without_excluded(self, measurements: Measurements) -> Measurements:
        """Measurements that are believed: those of excluded devices are removed."""
        if not (self._names or self._moved):
            return measurements
        nothing: dict[str, tuple[()]] = {_MEASURED[name]: () for name in self._names | self._moved}
        return replace(measurements, **nothing)  # type: ignore[arg-type]
