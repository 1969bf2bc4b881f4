"""Starts, lists, reads, answers and stops the commands of the console; standard library alone.

The folder of a job holds its whole state, so that any process of the console, also one that was started
later, can read it, answer it and stop it:

    command.json  words after `hil`, title, when
    process.json  PID, start time and boot of the process, written by itself before it becomes `hil`
    stdin         a named pipe; the process keeps its writing end open, too, so that it never closes
    stdout        one JSON object at the end
    stderr        progress, questions and figures as JSON objects, and messages, a line each
    answer-N      exists once the question that begins at byte N of stderr is answered
    finish        exists once the job was asked to end after its step

A process is signalled only if it is the one that wrote process.json: another process that has its PID since
then is not.
"""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from itertools import accumulate
from pathlib import Path
from select import PIPE_BUF
from typing import Any

from hil.console.json_files import read
from hil.core.event_rows import event_lines
from hil.core.result_names import end_of_session

COMMAND, PROCESS, STDIN, STDOUT, STDERR = "command.json", "process.json", "stdin", "stdout", "stderr"
STOPPED, FINISH, ANSWER = "stopped.json", "finish", "answer-"
NO_RESULT, BY_STOP = "ENDED", "STOPPED"
"""Verdicts of a job that left no result, and of one that STOP has ended."""
_HOLDS = {"progress": dict, "live": dict, "watched": dict, "held": dict, "question": str, "answered": str}
"""Keys of a JSON line on standard error, with the type of the value."""
LIVE = b'{"live": '
"""Begin of a line on standard error with figures of the loop."""
_TAIL_BYTES = 1 << 19
_MOST_SHOWN = 30
_STOPPING_S = 2.0
"""Time after STOP within which no question is answered."""
_START_S = 20.0
"""A job counts as running for this time after its start, before it has written its process.json."""


@dataclass(frozen=True)
class Job:
    """A job, identified by its folder.

    Attributes:
        folder: folder of its files.
        words: words of the command, after `hil`.
        title: title for people.
        started: seconds since the epoch.
    """

    folder: Path
    words: tuple[str, ...]
    title: str
    started: float

    @property
    def name(self) -> str:
        """Name of the folder; unique."""
        return self.folder.name


def start(root: Path, words: Sequence[str], title: str) -> Job:
    """Start a command of `hil` in a session of its own: no Ctrl-C, no end of this process reaches it.

    Args:
        root: folder of all jobs; made where it is missing.
        words: words of the command, with its `--json`.
        title: title for people.

    Raises:
        OSError: the folder cannot be written, or no process started.
    """
    root.mkdir(parents=True, exist_ok=True, mode=0o700)
    folder = root / f"{datetime.now(timezone.utc):%Y%m%d-%H%M%S-%f}"  # in order also as summer time ends
    folder.mkdir(mode=0o700)
    job = Job(folder, tuple(words), title, time.time())
    reported = {"words": job.words, "title": title, "started": job.started}
    (folder / COMMAND).write_text(json.dumps(reported), encoding="utf-8")
    os.mkfifo(folder / STDIN, 0o600)
    detached("hil.console.job_process", folder)
    return job


def detached(module: str, folder: Path) -> None:
    """Run a module on a folder in a session of its own, with no standard streams; raises `OSError`."""
    process = subprocess.Popen(
        [sys.executable, "-m", module, str(folder)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    threading.Thread(target=process.wait, daemon=True).start()  # leaves no zombie when it ends


def jobs(root: Path, most: int = 12) -> list[Job]:
    """The latest jobs of a folder, the latest first."""
    return [job for job in map(job_in, job_folders(root)[:most]) if job is not None]


def job_folders(root: Path) -> list[Path]:
    """Folders of jobs, the latest first."""
    try:
        return sorted((p for p in root.iterdir() if p.is_dir()), reverse=True)
    except OSError:
        return []


def job_in(folder: Path) -> Job | None:
    """The job of a folder; None where there is none."""
    tree = read(folder / COMMAND)
    words, title, started = tree.get("words"), tree.get("title"), tree.get("started")
    if isinstance(words, list) and isinstance(title, str) and isinstance(started, (int, float)):
        return Job(folder, tuple(map(str, words)), title, float(started))
    return None


def identity(pid: int) -> dict[str, Any]:
    """Identity of a process: PID, start time and boot. Empty once it is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return {}
    return {} if fields[0] in "ZX" else {"pid": pid, "ticks": int(fields[19]), "boot": boot}


def same(process: Mapping[str, Any]) -> bool:
    """Whether a process of this identity is running."""
    pid = process.get("pid")
    return isinstance(pid, int) and pid > 0 and identity(pid) == dict(process)


def alive(job: Job) -> bool:
    """Whether a job runs, or is about to start."""
    reported = read(job.folder / PROCESS)
    if reported:
        return same(reported)
    return 0.0 <= time.time() - job.started < _START_S


def send(job: Job, number: int) -> bool:
    """Send a signal to the process of a job, and to no other; returns whether the process exists."""
    return signal_process(read(job.folder / PROCESS), number)


def ignores(job: Job, number: int) -> bool:
    """Whether the process of a job ignores a signal, by what the kernel says of it."""
    pid = read(job.folder / PROCESS).get("pid")
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False
    mask = next((line.split()[1] for line in status.splitlines() if line.startswith("SigIgn:")), "0")
    return bool(int(mask, 16) >> (number - 1) & 1)


def signal_process(process: Mapping[str, Any], number: int) -> bool:
    """Send a signal to the process of this identity, and to no other; returns whether it exists."""
    if not same(process):
        return False
    try:
        handle = os.pidfd_open(process["pid"])
    except OSError:
        return False
    try:
        if same(process):  # the handle is that of this process, whatever becomes of its number
            signal.pidfd_send_signal(handle, number)
            return True
    except OSError:
        pass
    finally:
        os.close(handle)
    return False


def answer(job: Job, question_id: int, text: str) -> str:
    """Answer the current question of a job, once: a second answer is never used for the next question.

    Args:
        job: job with the question.
        question_id: identifier of the question, as `state` gives it.
        text: text of the answer; becomes one line, shorter than `PIPE_BUF` in bytes of UTF-8.

    Returns:
        Reason why the answer was rejected; empty if it was accepted.

    Raises:
        OSError: the folder of the job cannot be written.
    """
    line = (" ".join(text.split()) + "\n").encode("utf-8", "replace")
    if len(line) > PIPE_BUF:
        return f"an answer has less than {PIPE_BUF} bytes"
    reported = state(job)
    if reported["question_id"] != question_id:
        now = "nothing is asked any more" if reported["question"] is None else "read what is asked now"
        return f"that is not the question any more: {now}"
    if 0.0 <= time.time() - read(job.folder / STOPPED).get("when", 0.0) < _STOPPING_S:
        return f"{job.title} is being stopped: nothing is answered"
    claim = job.folder / f"{ANSWER}{question_id}"
    if not first(claim):
        return "another user has just answered that question"
    if put(job, line):
        return ""
    claim.unlink(missing_ok=True)
    return f"{job.title} has ended"


def first(claim: Path) -> bool:
    """Create an empty file atomically; returns whether it did not exist before. Raises `OSError`."""
    try:
        os.close(os.open(claim, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
    except FileExistsError:
        return False
    return True


def put(job: Job, line: bytes) -> bool:
    """Write to the standard input of a job, all or nothing; returns whether it was written.

    Args:
        job: job that reads it.
        line: less than `PIPE_BUF` bytes.
    """
    try:
        pipe = os.open(job.folder / STDIN, os.O_WRONLY | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        os.write(pipe, line)
    except OSError:
        return False
    finally:
        os.close(pipe)
    return True


def state(job: Job) -> dict[str, Any]:
    """What a page shows of a job: progress, question, figures, messages, how it ended. Plain values.

    `watched` is what is seen of its robot while no loop runs; `live_age_s` the age of the loop's figures.
    `question_id` identifies the question among those of the job: it is the byte at which it begins in
    `stderr`. An answered question is left out.
    """
    running = alive(job)
    reported: dict[str, Any] = {
        "name": job.name,
        "title": job.title,
        "command": " ".join(("hil", *job.words)),
        "started": job.started,
        "running": running,
        "stopping": running and (job.folder / STOPPED).exists(),
        "finishing": running and (job.folder / FINISH).exists(),
        "question": None,
        "question_id": None,
        "progress": None,
        "whole": None,
        "live": None,
        "live_age_s": None,
        "watched": None,
        "held": None,
        "messages": [],
        "events": [],
    }
    lines = _tail(job.folder / STDERR)
    live = [place for place, line in lines if line.startswith(LIVE.decode())]
    passed = frozenset(live[:-2])  # the last may be half written
    for place, line in lines:
        if place not in passed:
            _take(reported, place, line)
    del reported["messages"][:-_MOST_SHOWN]
    if running and reported["live"] is not None:
        reported["live_age_s"] = _age_s(reported["live"])
    if not running or (job.folder / f"{ANSWER}{reported['question_id']}").exists():
        reported |= {"question": None, "question_id": None}
    return reported if running else reported | _end(job, reported)


def _take(shown: dict[str, Any], place: int, line: str) -> None:
    """Add a line of standard error, which begins at byte `place`, to the state `shown`."""
    try:
        ((kind, data),) = json.loads(line).items()
        fits = isinstance(data, _HOLDS[kind])
    except (ValueError, AttributeError, KeyError, RecursionError):
        fits = False
    if not fits:
        shown["messages"].append(line)
        return
    if kind == "progress":
        shown["whole" if data.get("what") == "in all" else "progress"] = data
    elif kind == "question":
        shown |= {"question": data, "question_id": place}
    elif kind == "answered":
        shown |= {"question": None, "question_id": None}
    elif kind == "live":
        shown |= {"live": data, "watched": None, "held": None}  # of a bench before this one
        shown["events"] = list(data.get("events", ()))
    elif kind == "watched":
        shown |= {"watched": data, "events": list(data.get("events", ()))}
    else:
        shown[kind] = data


def _age_s(figures: Mapping[str, Any]) -> float | None:
    """Age of figures that a running process of this computer has told, s; None where it gives no time."""
    told_s = figures.get("host_s")
    return max(0.0, time.monotonic() - told_s) if isinstance(told_s, (int, float)) else None


def _end(job: Job, shown: Mapping[str, Any]) -> dict[str, Any]:
    """How a job ended, from the JSON object on its standard output."""
    result = read(job.folder / STDOUT)
    error = result.get("error")
    if result and "verdict" not in result and isinstance(error, dict):
        verdict = "ABORTED" if error.get("exit_code") == 4 else "ERROR"
        why = "; ".join(filter(None, (error.get("message"), error.get("remedy"))))
    elif result:
        verdict = str(result.get("verdict") or _judged(result))
        why = error["message"] if isinstance(error, dict) else _why(result)
    else:
        verdict, why = NO_RESULT, "it ended without a result: it was killed, or could not start"
    held = found if isinstance(found := result.get("held"), dict) else shown["held"]
    pages: dict[str, Any] = {
        k: v for k in ("report", "page", "folder") if isinstance(v := result.get(k), str)
    }
    if isinstance(result.get("findings"), list):
        pages["findings"] = result["findings"]
    if isinstance(events := result.get("events"), list):
        pages["events"] = event_lines(events)
    if verdict == "ABORTED" and (job.folder / STOPPED).exists():
        verdict, why = BY_STOP, "STOP was pressed"
    elif verdict == "ABORTED" and "ended" in result and (job.folder / FINISH).exists():
        verdict, why = "DONE", "ended from the page"
    how = {"emulated": "servos" in (result.get("emulated") or ()), "ended": _written_last(job)}
    return {"verdict": verdict, "why": why, "held": held, **how, **pages}


def _written_last(job: Job) -> float:
    """When the last word of a job was written, in seconds since the epoch; when it began if there is none."""
    times = [job.started]
    for name in (STDOUT, STDERR):
        with suppress(OSError):
            times.append((job.folder / name).stat().st_mtime)
    return max(times)


def _why(result: Mapping[str, Any]) -> str:
    """Why a command without an error ended: of acceptance, commissioning or the live loop."""
    stages, stopped = result.get("stages"), result.get("stopped")
    if isinstance(stopped, dict):
        return f"{stopped.get('procedure')}: {stopped.get('why')}"
    if isinstance(stages, list):  # `ended` of an acceptance is a date
        return "; ".join(
            f"{s.get('name')}: {s['why']}" for s in stages if isinstance(s, dict) and s.get("why")
        )
    return str(result.get("ended", ""))


def _judged(result: Mapping[str, Any]) -> str:
    """Verdict for a result without one: of doctor, or of the live loop, from the reason of its end."""
    if "ok" in result:
        return "PASS" if result["ok"] else "FAIL"
    end = end_of_session(str(result.get("ended", "duration")), "")
    return "ABORTED" if end == "ENDED" else end


def _tail(path: Path) -> list[tuple[int, str]]:
    """The last lines of a file that may be long, each with the byte at which it begins."""
    try:
        with path.open("rb") as file:
            begin = max(0, file.seek(0, os.SEEK_END) - _TAIL_BYTES)
            file.seek(begin)
            lines = file.read().splitlines(keepends=True)
    except OSError:
        return []
    places = accumulate(map(len, lines), initial=begin)
    texts = (line.decode("utf-8", "replace").rstrip("\r\n") for line in lines)
    reported = list(zip(places, texts, strict=False))  # the last place is behind the last line
    return [(place, text) for place, text in reported[begin > 0 :] if text.strip()]
