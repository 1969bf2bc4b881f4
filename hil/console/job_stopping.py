"""Stops whatever the console has started, by the signals that a terminal sends; standard library alone.

SIGINT first, as Ctrl-C, which every command handles; then SIGTERM, which ends a procedure in the middle of a
step. Both end in wheels at rest, steering held and torque on. SIGKILL is never sent: then only the watchdogs
of its servos would stop the robot.
"""

import json
import signal
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from hil.console.jobs import FINISH, NO_RESULT, STOPPED, Job, alive, first, ignores, jobs, send, state

_GRACE_S = 0.3
_POLL_S = 0.02
_MOST = 200


def stop_all(root: Path) -> list[Job]:
    """Ask every running job to stop now; returns them. Does not wait for their ends.

    Args:
        root: folder of the jobs.
    """
    asked = [job for job in jobs(root, _MOST) if alive(job)]
    for job in asked:
        with suppress(OSError):  # a full disk must not prevent stopping
            (job.folder / STOPPED).write_text(json.dumps({"when": time.time()}), encoding="utf-8")
        send(job, signal.SIGINT)
    until_s = time.monotonic() + _GRACE_S
    while time.monotonic() < until_s and any(map(alive, asked)):
        time.sleep(_POLL_S)
    for job in asked:
        send(job, signal.SIGTERM)
    return asked


def finish(job: Job) -> str:
    """End one job after its step, as one Ctrl-C does. Never twice: a second SIGINT would end it at once.

    Returns:
        Reason why no signal was sent; empty if it was sent.

    Raises:
        OSError: the folder of the job cannot be written.
    """
    claim = job.folder / FINISH
    if not first(claim):
        return "it was asked to end already: STOP ends it at once"
    if ignores(job, signal.SIGINT):
        why_not = "its process ignores the request (SIGINT): STOP ends it"
    elif send(job, signal.SIGINT):
        return ""
    else:
        why_not = "it has ended"
    claim.unlink(missing_ok=True)
    return why_not


def wait_for(asked: Sequence[Job], limit_s: float) -> list[dict[str, Any]]:
    """The states of jobs once all have ended, or when time is up.

    Args:
        asked: jobs to wait for.
        limit_s: longest wait.
    """
    until_s = time.monotonic() + limit_s
    while time.monotonic() < until_s and any(map(alive, asked)):
        time.sleep(_POLL_S)
    return [state(job) for job in asked]


def in_words(ended: dict[str, Any]) -> str:
    """One line on how a stopped job left the robot."""
    if ended["running"]:
        return f"{ended['title']}: still stopping; secure the robot"
    held = ended.get("held")
    if held:
        return f"{ended['title']}: {held['state']}: {held['why']}"
    if ended["verdict"] == NO_RESULT:
        return f"{ended['title']}: {ended['why']}; check whether the robot is held"
    return f"{ended['title']}: {ended['verdict']}"
