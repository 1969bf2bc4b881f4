"""What `hil doctor` asks of a range finder: distances, and how strong the echo is."""

from __future__ import annotations

from collections.abc import Iterator
from statistics import median, pstdev

from hil.devices.looks import Watched, losses
from hil.vocabulary.finding import Finding, Level
from hil.vocabulary.signals import Status

_FAINT = 200
_AIMED = (Status.LOW_CONFIDENCE, Status.IMPLAUSIBLE)


def look(watched: Watched) -> Iterator[Finding]:
    """Findings about a range finder that was watched."""
    name, samples = watched.kind.name, watched.samples
    whole = (Status.OK if s.status in _AIMED else s.status for s in samples)
    yield losses(name, whole, watched.due, "check wiring and baud rate")
    if not samples:
        return
    good = [s.distance_m for s in samples if s.status is Status.OK]
    strength = median(s.strength for s in samples)
    level: Level = "ok" if good and strength >= _FAINT else "warning"
    remedy = "point it at something bright between 0.2 and 8 m away, and clean its lenses"
    yield Finding(name, "echo", level, f"strength {strength:g}", f"{_FAINT} or more", remedy)
    if good:
        told = f"{median(good):.3f} m, spread {1e3 * pstdev(good):.0f} mm"
        yield Finding(name, "distance", "ok", told)
