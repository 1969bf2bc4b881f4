"""`python -m hil.console.stop_server FOLDER`: serves the STOP button, and outlives the page.

It starts before the page and shares nothing with it but a folder of files. A browser opens the page of this
server: the button, and the console in a frame below. When the page's process is dead, the button still works,
also after a reload. It is small and needs the standard library alone, so that little can go wrong in it.

It ends with the console; when the console was killed, ten minutes after the last job, or at once by
`hil console --stop`.
"""

import os
import signal
import sys
import threading
import time
from http import HTTPStatus
from importlib import resources
from pathlib import Path
from typing import Any

from hil.console import jobs
from hil.console.job_stopping import in_words, stop_all
from hil.console.json_files import put_private, read
from hil.console.not_held_alarm import Alarm
from hil.console.web_server import NAMES, Refused, Reply, Request, Route, Server, as_json
from hil.core.errors import reason_of

ASKED, STOP, PAGE = "asked.json", "stop.json", "page.json"
IDENTITY = ("pid", "ticks", "boot")
POLICY = (
    "default-src 'self'; img-src data:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'; "
    "frame-src " + " ".join(f"http://{name}:*" for name in NAMES)
)
_LINGER_S, _START_S = 600.0, 60.0
_LOOK_S, _POLL_S = 0.5, 0.05
_END_S = 10.0


def asset(name: str) -> Reply:
    """Reply with a file of the folder `pages`."""
    kinds = {"html": "text/html", "css": "text/css", "js": "text/javascript"}
    content = (resources.files("hil.console") / "pages" / name).read_bytes()
    return Reply(content, f"{kinds[name.rpartition('.')[2]]}; charset=utf-8")


def runs(process: dict[str, Any]) -> bool:
    """Whether the process in the content of such a file is running."""
    return jobs.same({key: process.get(key) for key in IDENTITY})


def end_without_page(folder: Path) -> bool:
    """End the process with the button if the page has died and no job runs; returns whether it has ended.

    Args:
        folder: folder of the console.
    """
    button = read(folder / STOP)
    if not runs(button) or runs(read(folder / PAGE)) or any(map(jobs.alive, jobs.jobs(folder / "jobs"))):
        return False
    put_private(folder / PAGE, {"ended": True})
    until_s = time.monotonic() + _END_S
    while runs(button) and time.monotonic() < until_s:
        time.sleep(_POLL_S)
    return not runs(button)


class StopProcess:
    """Routes of the page with the button; decides when its server ends.

    Args:
        folder: folder of the console.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._alarm, self._asking = Alarm(folder), threading.Lock()

    def routes(self) -> dict[tuple[str, str], Route]:
        """Routes by method and path."""
        return {
            ("GET", "/"): lambda _: asset("stop.html"),
            ("GET", "/stop.js"): lambda _: asset("stop.js"),
            ("GET", "/style.css"): lambda _: asset("style.css"),
            ("GET", "/state"): self._state,
            ("POST", "/stop"): self._stop,
            ("POST", "/secured"): self._secured,
        }

    def _stop(self, request: Request) -> Reply:
        asked = stop_all(self._folder / "jobs")
        return as_json({"asked": [job.title for job in asked]})

    def _secured(self, request: Request) -> Reply:
        """Note that a person has secured the robots that these jobs left; later jobs are not covered."""
        names = request.body.get("jobs")
        if not isinstance(names, list):
            raise Refused(HTTPStatus.BAD_REQUEST, "expected the names of jobs")
        with self._asking:
            try:
                self._alarm.secure(list(map(str, names)))
            except OSError as error:
                text = f"{error.filename or self._folder}: {reason_of(error)}: the alarm stays"
                raise Refused(HTTPStatus.INTERNAL_SERVER_ERROR, text) from None
        return as_json({})

    def _state(self, request: Request) -> Reply:
        page = read(self._folder / PAGE)
        latest = jobs.jobs(self._folder / "jobs", 1)
        shown = [job for job in jobs.jobs(self._folder / "jobs") if jobs.alive(job)] or latest
        reported = []
        for job in shown:
            state = jobs.state(job)
            keys = ("name", "title", "running", "stopping", "question", "watched", "held", "verdict", "why")
            reported.append(
                {k: state.get(k) for k in keys} | {"words": "" if state["running"] else in_words(state)}
            )
        with self._asking:
            left = self._alarm.not_held()
        return as_json({"page": page.get("port") if runs(page) else None, "jobs": reported, "not_held": left})

    def serve_until_idle(self, server: Server) -> None:
        """Watch page and jobs; stop serving when neither needs the button any more."""
        begun_s = needed_s = time.monotonic()
        while True:
            page = read(self._folder / PAGE)
            if runs(page) or any(map(jobs.alive, jobs.jobs(self._folder / "jobs"))):
                needed_s = time.monotonic()
            elif page.get("ended") or (not page and time.monotonic() - begun_s > _START_S):
                break  # an orderly end, or the page never started
            elif time.monotonic() - needed_s > _LINGER_S:
                break
            time.sleep(_LOOK_S)
        server.shutdown()


def main() -> None:
    """Serve on the port that the console asked for."""
    folder = Path(sys.argv[1])
    asked = read(folder / ASKED)
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    process = StopProcess(folder)
    try:
        server = Server(int(asked["port"]), asked["token"], asked["cookie"], process.routes(), POLICY)
    except (OSError, KeyError, ValueError) as error:
        put_private(folder / STOP, {"error": reason_of(error)})
        return
    reported = jobs.identity(os.getpid()) | {
        "token": asked["token"],
        "cookie": asked["cookie"],
        "port": server.port,
    }
    put_private(folder / STOP, reported)
    threading.Thread(target=process.serve_until_idle, args=(server,), daemon=True).start()
    server.serve_forever(poll_interval=0.2)


if __name__ == "__main__":
    main()
