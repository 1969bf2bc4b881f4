"""What a job has told of its loop so far, for a page that is opened later; standard library alone."""

import json
from collections.abc import Sequence
from typing import Any

from hil.console.jobs import LIVE, STDERR, Job


def past(job: Job, path: int, latest: int) -> dict[str, list[Any]]:
    """Figures of the loop of a job so far.

    Args:
        job: the job.
        path: largest number of positions; they are evenly thinned.
        latest: number of the last figures to return whole.

    Returns:
        `path`, positions of the robot (x, y) in m, and `latest`, the last figures; both in the order of time.
    """
    try:
        with (job.folder / STDERR).open("rb") as file:
            lines = [line for line in file if line.startswith(LIVE)]
    except OSError:
        lines = []
    thinned = lines[:: -(-len(lines) // path)] if lines else []
    poses = [figures.get("pose") for figures in _read(thinned)]
    places = [pose[:2] for pose in poses if isinstance(pose, list)]
    known = [place for place in places if len(place) == 2 and None not in place]
    return {"path": known, "latest": _read(lines[-latest:])}


def _read(lines: Sequence[bytes]) -> list[dict[str, Any]]:
    found = []
    for line in lines:
        try:
            figures = json.loads(line)["live"]
        except (ValueError, RecursionError):  # cut off by a full disk, or still being written
            continue
        if isinstance(figures, dict):
            found.append(figures)
    return found
