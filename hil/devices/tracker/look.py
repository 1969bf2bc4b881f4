"""What the doctor asks of a tracking camera: samples and confidence."""

from __future__ import annotations

from collections.abc import Iterator

from hil.devices.looks import Watched, losses
from hil.vocabulary.finding import Finding


def look(watched: Watched) -> Iterator[Finding]:
    """Findings about a camera that was watched."""
    yield losses(
        "tracker", (s.status for s in watched.samples), watched.due,
        "clean the lenses, light the scene, use a USB 3 port",
    )  # fmt: skip
    if watched.samples:
        confidence = watched.samples[-1].confidence
        yield Finding(
            "tracker", "confidence", "ok" if confidence >= 2 else "warning", f"{confidence} of 3",
            "2 or 3", "move the camera a little; the scene needs texture",
        )  # fmt: skip
