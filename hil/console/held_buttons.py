"""Buttons that move the robot while they are held, by the keys of `hil jog`; standard library alone.

The page repeats a held button, as a terminal repeats a key. When nothing comes any more, because the button
was let go, or the page, the browser or the connection is gone, `hil jog` takes the key for let go.
"""

from hil.console.jobs import STOPPED, Job, put

KEYS = ("w", "s", "a", "d", "q", "e")


def hold(job: Job, key: str) -> str:
    """Pass on that a button is held now.

    Args:
        job: a running `hil jog`.
        key: key of `hil jog` that the button stands for, of `KEYS`.

    Returns:
        Reason why nothing moves; empty if the key was passed on.
    """
    if job.words[:1] != ("jog",):
        return f"{job.title} takes no keys: start jog"
    if (job.folder / STOPPED).exists():
        return f"{job.title} is being stopped"
    return "" if put(job, key.encode()) else f"{job.title} has ended"
