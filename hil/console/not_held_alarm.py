"""The alarm for robots that jobs of the console left NOT HELD; it stays until reset. Standard library only.

It is computed from the folders of the jobs, so that it survives a reload or a restart. A later job resets it
only if it ran on the same bench and found the robot held; a job that opened no device, or only examined the
devices, does not. A person can also reset it by confirming that the robot is secured.

An alarm says which bench, when, and whether the robot is real. That of an emulated robot is reset in the same
two ways, although its world ended with the run.
"""

from collections.abc import Collection, Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from hil.console.jobs import NO_RESULT, PROCESS, Job, job_folders, job_in, state
from hil.console.json_files import put_private, read

SECURED = "secured.json"
_BENCH, _EMULATE = "--bench=", "--emulate="


class Alarm:
    """Alarm of one console: the robots that are not known to be held.

    Args:
        folder: folder of the console.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._jobs: dict[Path, Job | None] = {}
        self._ended: dict[Job, dict[str, Any]] = {}

    def not_held(self) -> list[dict[str, str]]:
        """Job and message of each bench whose robot it left NOT HELD."""
        secured = self._secured()
        left: dict[tuple[str, ...], dict[str, str]] = {}
        looked: set[tuple[str, ...]] = set()
        for job in self._latest_first():
            bench = _bench(job)
            reported = {} if bench in looked else self._reported_of(job)
            if _is_loose(reported) or _found_held(reported):
                looked.add(bench)
                if _is_loose(reported) and job.name not in secured:
                    left[bench] = {"job": job.name, "words": _in_words(job, reported)}
        return list(left.values())

    def _latest_first(self) -> Iterator[Job]:
        """All jobs, the latest first; the data of a job that cannot change are read once."""
        for folder in job_folders(self._folder / "jobs"):
            job = self._jobs.get(folder) or job_in(folder)
            self._jobs[folder] = job
            if job is not None:
                yield job

    def _reported_of(self, job: Job) -> Mapping[str, Any]:
        """How a job ended; empty while it runs."""
        if job not in self._ended:
            reported = state(job)
            if reported["running"]:
                return {}
            if not (job.folder / PROCESS).exists():  # it may still start
                return reported
            self._ended[job] = reported
        return self._ended[job]

    def secure(self, names: Collection[str]) -> None:
        """Note that a person has secured the robots that these jobs left; raises `OSError`."""
        there = {left["job"] for left in self.not_held()} & set(names)
        if there:
            put_private(self._folder / SECURED, {"jobs": sorted(self._secured() | there)})

    def _secured(self) -> set[str]:
        names = read(self._folder / SECURED).get("jobs")
        return set(map(str, names)) if isinstance(names, list) else set()


def _is_loose(ended: Mapping[str, Any]) -> bool:
    """Whether a job that has ended left its robot NOT HELD, or drove and was killed before it could say."""
    held = ended.get("held")
    if held:
        return bool(held.get("state") == "NOT HELD")
    return ended.get("verdict") == NO_RESULT and ended.get("live") is not None


def _found_held(ended: Mapping[str, Any]) -> bool:
    """Whether a job has looked at the robot and found it held, or at rest where it need not be held."""
    held = ended.get("held") or {}
    return held.get("state") == "HELD" or (
        held.get("state") == "not needed" and held.get("moved_m") is not None
    )


def _bench(job: Job) -> tuple[str, ...]:
    """What identifies the bench of a job: its file, and which of its devices are emulated."""
    words = job.words[: job.words.index("--")] if "--" in job.words else job.words
    return tuple(sorted(word for word in words if word.startswith((_BENCH, _EMULATE))))


def _in_words(job: Job, ended: Mapping[str, Any]) -> str:
    """Which robot, when, why, and what to do."""
    shown = ended.get("live") or {}
    file = next((word.removeprefix(_BENCH) for word in _bench(job) if word.startswith(_BENCH)), "")
    bench = shown.get("bench") or file or "emulated"
    real = shown["robot"] == "real" if "robot" in shown else bool(file) and not ended["emulated"]
    robot = f"{'Real' if real else 'Emulated'} robot, bench {bench}"
    robot += f" ({file})" if file not in ("", bench) else ""
    robot += f", {datetime.fromtimestamp(ended['ended']):%Y-%m-%d %H:%M:%S}"
    held = ended.get("held")
    if not held:
        rest = " Check whether the robot is held." if real else ""
        return f"{robot}: {job.title} was killed while its loop ran.{rest}"
    why = str(held.get("why")).rstrip(".")
    rest = " Secure it before you do anything else." if real else ""
    return f"{robot}: NOT HELD after {job.title}: {why}.{rest}"
