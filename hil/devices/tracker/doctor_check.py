"""What the doctor asks of a tracking camera: samples and confidence."""

from __future__ import annotations

from collections.abc import Iterator

from hil.core.finding import Finding
from hil.core.signals import Status
from hil.devices.doctor_watch import Watched, losses

_SLOWEST = 0.9
_UNSURE = "clean the lenses, light the scene, look whether the camera is shaken"
_FEW = "use a USB 3 port or a faster link, or set tracker.rate_hz to what is sent, where the table has it"


def look(watched: Watched) -> Iterator[Finding]:
    """Findings about a camera that was watched."""
    statuses, due = [s.status for s in watched.samples], watched.due
    if len(statuses) >= _SLOWEST * due:
        due = min(due, len(statuses))  # its own rate, a little below the one that is written
    unsure = any(status not in (Status.OK, Status.STARTING) for status in statuses)
    yield losses("tracker", statuses, due, _UNSURE if unsure else _FEW)
    if watched.samples:
        confidence = watched.samples[-1].confidence
        yield Finding(
            "tracker",
            "confidence",
            "ok" if confidence >= 2 else "warning",
            f"{confidence} of 3",
            "2 or 3",
            "move the camera a little; the scene needs texture",
        )
