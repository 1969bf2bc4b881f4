"""Serves the console's page: commands, running jobs, devices, history. It touches no device.

Everything that moves is an ordinary command in a process of its own (`hil.console.jobs`). So this process may
be killed or started again at any time, and may receive any request.
"""

import threading
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import quote

from hil.config.device_place import device_place
from hil.config.loading import load_bench
from hil.console import jobs
from hil.console.command_forms import Action
from hil.console.held_buttons import KEYS, hold
from hil.console.job_stopping import finish
from hil.console.past_figures import past
from hil.console.stop_server import asset
from hil.console.web_server import NAMES, Refused, Reply, Request, Route, as_json
from hil.core.errors import DataError, HilError, reason_of
from hil.core.registry import kinds
from hil.core.result_names import SESSION, TRENDS
from hil.report.history.index import find_results
from hil.report.history.opening import PAGES as RESULT_PAGES
from hil.report.history.opening import page_of
from hil.report.history.query import chosen, named

RESULTS, PAGES = "/results/", "/pages/"
_MOST_RESULTS = 200
_SHOWN_JOBS = 6
_PATH_POINTS, _PLOTTED = 2000, 120
"""Largest number of positions of a path, and number of the last figures for the plots."""
_SANDBOX = {
    "Content-Security-Policy": "sandbox allow-scripts allow-popups allow-downloads; default-src 'none'; "
    "img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; base-uri 'none'"
}
"""Pages of results may come from anywhere: they are sandboxed, without rights of this console or network."""
_KINDS = {
    ".html": "text/html; charset=utf-8",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".json": "application/json",
    ".xml": "text/xml",
    ".toml": "text/plain; charset=utf-8",
    ".txt": "text/plain; charset=utf-8",
    ".csv": "text/plain; charset=utf-8",
    ".jsonl": "text/plain; charset=utf-8",
}


def policy(stop_port: int) -> str:
    """Content security policy of the page: only the page with the button may hold it in a frame."""
    owners = " ".join(f"http://{name}:{stop_port}" for name in NAMES)
    return f"default-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors {owners}"


class PageProcess:
    """Routes of the page.

    Args:
        folder: folder of the console.
        results: folder of results.
        actions: commands and procedures that can be started.
        benches: names to choose from.
        bench: default of the forms; None for the default of each command.
    """

    def __init__(
        self,
        folder: Path,
        results: Path,
        actions: Callable[[], Sequence[Action]],
        benches: Callable[[], Sequence[str]],
        bench: str | None,
    ) -> None:
        self._jobs, self._results, self._own = folder / "jobs", results, bench is not None
        self._bench = bench or "emulated"
        self._make_actions = actions
        self._benches = benches
        self._ended: dict[str, dict[str, Any]] = {}
        self._starting, self._reading = threading.Lock(), threading.Lock()

    @cached_property
    def _actions(self) -> dict[str, Action]:
        """Actions by name, made at the first request, because reading all procedures takes a while."""
        with self._reading:
            return self.__dict__.get("_actions") or {action.name: action for action in self._make_actions()}

    def routes(self) -> dict[tuple[str, str], Route]:
        """Routes by method and path."""
        pages: dict[tuple[str, str], Route] = {
            ("GET", "/"): lambda _: asset("console.html"),
            ("GET", "/console.js"): lambda _: asset("console.js"),
            ("GET", "/forms.js"): lambda _: asset("forms.js"),
            ("GET", "/plots.js"): lambda _: asset("plots.js"),
            ("GET", "/hold.js"): lambda _: asset("hold.js"),
            ("GET", "/style.css"): lambda _: asset("style.css"),
        }
        asked: dict[tuple[str, str], Route] = {
            ("GET", "/api/offer"): self._offer,
            ("GET", "/api/state"): self._state,
            ("GET", "/api/past"): self._past,
            ("GET", "/api/bench"): self._devices,
            ("GET", "/api/results"): self._history,
            ("POST", "/api/start"): self._start,
            ("POST", "/api/answer"): self._answer,
            ("POST", "/api/finish"): self._finish,
            ("POST", "/api/hold"): self._hold,
            ("GET", RESULTS): self._result,
            ("GET", PAGES): self._file,
            ("GET", "/trends"): self._trends,
        }
        return pages | {key: _with_errors(route) for key, route in asked.items()}

    def _offer(self, request: Request) -> Reply:
        offered = [action.to_json() for action in self._actions.values()]
        elsewhere = "" if self._results.resolve() == Path("out").resolve() else str(self._results)
        return as_json(
            {
                "actions": offered,
                "benches": list(self._benches()),
                "bench": self._bench,
                "own": self._own,
                "elsewhere": elsewhere,
            }
        )

    def _state(self, request: Request) -> Reply:
        return as_json({"jobs": [self._job(job) for job in jobs.jobs(self._jobs, _SHOWN_JOBS)]})

    def _job(self, job: jobs.Job) -> dict[str, Any]:
        """State of a job; the state of an ended job is cached, because it no longer changes."""
        if job.name not in self._ended:
            state = jobs.state(job)
            if state["running"]:
                return state
            state["link"] = self._link(job, state)
            self._ended[job.name] = state
        return self._ended[job.name]

    def _past(self, request: Request) -> Reply:
        """What a page that was opened later has missed."""
        return as_json(past(self._named(request.query.get("job", "")), _PATH_POINTS, _PLOTTED))

    def _link(self, job: jobs.Job, state: Mapping[str, Any]) -> str | None:
        """Address of the page that a job has left; the page of a session is written when it is asked for."""
        page, where = state.get("report") or state.get("page"), PAGES
        if not page and "--out" in job.words:
            folder = Path(job.words[job.words.index("--out") + 1])
            page, where = (str(folder), RESULTS) if (folder / SESSION).is_file() else (None, PAGES)
        if not page:
            return None
        try:
            within = Path(page).resolve().relative_to(self._results.resolve())
        except (ValueError, OSError):
            return None
        return f"{where}{quote(within.as_posix())}"

    def _start(self, request: Request) -> Reply:
        action = self._actions.get(str(request.body.get("action")))
        values = request.body.get("values")
        if action is None or not isinstance(values, dict):
            raise Refused(HTTPStatus.BAD_REQUEST, "there is nothing like that to start")
        filled = {str(key): str(value).strip() for key, value in values.items() if str(value).strip()}
        known = {one.name for one in action.fields}
        unknown = {name: "there is no such field" for name in filled if name not in known}
        problems = unknown or action.problems(filled)
        if problems:
            return as_json({"problems": problems})
        with self._starting:
            running = [job for job in jobs.jobs(self._jobs) if jobs.alive(job)]
            if running:
                raise Refused(HTTPStatus.CONFLICT, f"{running[0].title} is still running: wait, or stop it")
            job = jobs.start(self._jobs, action.words(filled), filled.get("SCRIPT", action.name))
        return as_json({"job": job.name})

    def _one(self, request: Request) -> jobs.Job:
        return self._named(str(request.body.get("job")))

    def _named(self, name: str) -> jobs.Job:
        found = next((job for job in jobs.jobs(self._jobs) if job.name == name), None)
        if found is None:
            raise Refused(HTTPStatus.NOT_FOUND, "there is no such run")
        return found

    def _answer(self, request: Request) -> Reply:
        job = self._one(request)
        question_id, text = request.body.get("question_id"), request.body.get("text")
        if not isinstance(question_id, int) or isinstance(question_id, bool) or not isinstance(text, str):
            raise Refused(
                HTTPStatus.BAD_REQUEST,
                "expected the question_id of the question that is answered, from /api/state, and a text",
            )
        if why_not := jobs.answer(job, question_id, text):
            raise Refused(HTTPStatus.CONFLICT, why_not)
        return as_json({})

    def _finish(self, request: Request) -> Reply:
        if why_not := finish(self._one(request)):
            raise Refused(HTTPStatus.CONFLICT, why_not)
        return as_json({})

    def _hold(self, request: Request) -> Reply:
        job, key = self._one(request), request.body.get("key")
        if key not in KEYS:
            raise Refused(HTTPStatus.BAD_REQUEST, f"expected a key: one of {', '.join(KEYS)}")
        if why_not := hold(job, str(key)):
            raise Refused(HTTPStatus.CONFLICT, why_not)
        return as_json({})

    def _devices(self, request: Request) -> Reply:
        config = load_bench(request.query.get("name", self._bench))
        rows = []
        for name, device in config.devices().items():
            place = device_place(device) if device.backend == "real" else ""
            model = getattr(device, "model", "")
            title = next((m.title for m in kinds()[name].models if m.name == model), model)
            rows.append({"name": name, "model": title, "backend": device.backend, "place": place})
        return as_json({"bench": config.name, "devices": rows, "start": config.knows_start})

    def _history(self, request: Request) -> Reply:
        words = tuple(request.query.get("words", "").split())
        if not self._results.is_dir():
            return as_json({"found": 0, "results": []})
        found = chosen(find_results(self._results), words=words)
        rows = [
            {
                "name": k.name,
                "kind": k.kind,
                "procedure": k.what,
                "when": f"{k.when.astimezone():%Y-%m-%d %H:%M}",
                "bench": f"{k.bench} ({k.where})" if k.where else k.bench,
                "verdict": k.verdict,
                "why": (k.result.get("error") or {}).get("message") or k.why,
                "link": f"{RESULTS}{quote(k.name)}" if k.kind in RESULT_PAGES else None,
            }
            for k in found[:_MOST_RESULTS]
        ]
        return as_json({"found": len(found), "results": rows})

    def _result(self, request: Request) -> Reply:
        """The page of a result by its name."""
        kept = named(find_results(self._results), request.path.removeprefix(RESULTS), whole=True)
        return _elsewhere(PAGES + quote(page_of(kept).relative_to(self._results).as_posix()))

    def _file(self, request: Request) -> Reply:
        """A file of the results folder, except hidden files and the console's own."""
        root, name = self._results.resolve(), request.path.removeprefix(PAGES)
        try:
            path = (root / name).resolve()
            parts = path.relative_to(root).parts
        except (ValueError, OSError):
            path, parts = root, ()
        hidden = any(part.startswith(".") for part in parts)
        ours = path.is_relative_to(self._jobs.parent.resolve())
        if not parts or hidden or ours or path.suffix not in _KINDS or not path.is_file():
            raise Refused(HTTPStatus.NOT_FOUND, f"there is no page {name!r} in {self._results}")
        return Reply(path.read_bytes(), _KINDS[path.suffix], headers=_SANDBOX)

    def _trends(self, request: Request) -> Reply:
        from hil.report.history.page import write_trends_page
        from hil.report.history.series import groups
        from hil.report.result_reader import own_file

        found = chosen(find_results(self._results), within=True)
        write_trends_page(own_file(self._results, TRENDS), groups(found))
        return _elsewhere(PAGES + TRENDS)


def _elsewhere(place: str) -> Reply:
    return Reply(b"", status=HTTPStatus.SEE_OTHER, headers={"Location": place})


def _with_errors(route: Route) -> Route:
    """Wrap a route: an expected error becomes a reply with a status and a sentence."""

    def answered(request: Request) -> Reply:
        try:
            return route(request)
        except DataError as error:
            raise Refused(HTTPStatus.NOT_FOUND, str(error)) from None
        except HilError as error:
            raise Refused(HTTPStatus.BAD_REQUEST, str(error)) from None
        except OSError as error:
            raise Refused(HTTPStatus.INTERNAL_SERVER_ERROR, f"{error.filename}: {reason_of(error)}") from None

    return answered
