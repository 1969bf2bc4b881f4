"""`hil console`: the bench in a browser, with a STOP that does not depend on it."""

from __future__ import annotations

import json
import secrets
import signal
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.completion_types import BENCH
from hil.cli.options import FILE, JSON
from hil.core.errors import EXIT_DEVICE, EXIT_PASS, DataError, UsageError

if TYPE_CHECKING:
    from hil.console.command_forms import Action
    from hil.console.web_server import Server

_START_S, _POLL_S, _STOP_S = 10.0, 0.05, 60.0
_AGAIN = "it is just starting: give the same command again in ten seconds for the address"


@click.command()
@click.option(
    "--bench", type=BENCH, help="Bench file or profile that the page offers [default: each command's own]."
)
@click.option("--in", "where", type=FILE, default=Path("out"), show_default=True, help="Folder of results.")
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Page's port [default: a free one].")
@click.option("--stop", "stopping", is_flag=True, help="Stop what the console of this folder runs.")
@JSON
def command(bench: str | None, where: Path, port: int, stopping: bool, as_json: bool) -> int:
    """The bench in a browser of this computer: devices, procedures, live figures, STOP, history.

    Prints an address with a token. The page opens only with this token, and only on this computer. Ctrl-C
    ends the console; jobs that it started keep running, and `hil console --stop` stops them. STOP is no
    emergency stop: keep the switch that cuts the power.

    Example: hil console --bench my.toml
    """
    folder = where / "console"
    if stopping:
        if bench is not None or port:
            raise UsageError("--stop only stops", remedy="leave --bench and --port out")
        if not where.is_dir():
            raise DataError(
                str(where), "there is no such folder", remedy="name the folder of the console with --in"
            )
        return _stop(folder, as_json=as_json)
    return _serve(folder, where, bench, port, as_json=as_json)


def _stop(folder: Path, *, as_json: bool) -> int:
    """Stop every job by its own files: needs neither the page nor the process with the button."""
    from hil.console import jobs
    from hil.console.job_stopping import in_words, stop_all, wait_for
    from hil.console.not_held_alarm import Alarm
    from hil.console.stop_server import end_without_page

    ended = wait_for(stop_all(folder / "jobs"), _STOP_S)
    button = end_without_page(folder)
    left = Alarm(folder).not_held()
    last = [] if ended else [jobs.state(job) for job in jobs.jobs(folder / "jobs", 1)]
    if as_json:
        keys = ("title", "running", "held", "verdict", "why")
        stopped, before = ([{k: job.get(k) for k in keys} for job in some] for some in (ended, last))
        reported = {"stopped": stopped, "last": next(iter(before), None), "not_held": left}
        click.echo(json.dumps(reported | {"button_ended": button}))
    else:
        said = [in_words(job) for job in ended]
        said = said or [f"nothing runs that the console in {folder.parent} has started"]
        said += [f"the last was {in_words(job)}" for job in last]
        said += ["the STOP button of a console that died has ended"] * button
        click.echo("\n".join([*said, *_alarm(left)]))
    return EXIT_DEVICE if left or any(job["running"] for job in ended) else EXIT_PASS


def _alarm(left: Sequence[Mapping[str, str]]) -> list[str]:
    """Messages about robots that were left NOT HELD, and how to clear the alarm."""
    rest = "once it is secured, say so on the page of hil console, or end a run on that bench HELD"
    return [*(robot["words"] for robot in left), *([rest] if left else [])]


def _serve(folder: Path, where: Path, bench: str | None, port: int, *, as_json: bool) -> int:
    from hil.config.loading import load_bench
    from hil.console.json_files import put_private, read
    from hil.console.page_server import PageProcess, policy
    from hil.console.stop_server import PAGE, runs
    from hil.console.web_server import Server
    from hil.support.atomic_files import check_folder
    from hil.support.folder_lock import locked
    from hil.support.interrupt_signals import StopRequest

    load_bench(bench or "emulated")
    check_folder(folder)
    stop = StopRequest()
    with stop.noted(), ExitStack() as stack:
        folder.mkdir(parents=True, exist_ok=True)
        folder.chmod(0o700)  # the token lies in it
        if runs(read(folder / PAGE)):
            raise UsageError(
                f"a console for {where} is running already",
                remedy=f"{_way_in(folder)}, or name another folder with --in",
            )
        stack.enter_context(locked(folder, "a console", _AGAIN))
        stopper = _stopper(folder, port)
        process = PageProcess(folder, where, lambda: _actions(where), _benches, bench)
        server = Server(0, stopper["token"], stopper["cookie"], process.routes(), policy(stopper["port"]))
        url = _address(stopper)
        _open(server, folder)
        click.echo(json.dumps({"url": url, "folder": str(folder)}) if as_json else url)
        click.echo("hil: open this address in a browser; Ctrl-C ends the console", err=True)
        try:
            while not stop.name:
                time.sleep(_POLL_S)
                stopper = stopper if runs(stopper) else _stopper(folder, stopper["port"], stopper)
        finally:
            server.shutdown()
            server.server_close()
            put_private(folder / PAGE, {"ended": True})
    _farewell(folder)
    return EXIT_PASS


def _address(stopper: Mapping[str, Any]) -> str:
    """Address of the page with the STOP button."""
    from hil.console.web_server import HOST

    return f"http://{HOST}:{stopper['port']}/?token={stopper['token']}"


def _way_in(folder: Path) -> str:
    """How to open the console that already runs in a folder, in words."""
    from hil.console.json_files import is_private, read
    from hil.console.stop_server import PAGE, STOP, runs

    stopper = read(folder / STOP)
    if not runs(stopper):
        return f"its STOP button: {_AGAIN}"
    if is_private(folder / STOP):
        return f"open {_address(stopper)} in a browser"
    return (
        f"its address is not shown, because {folder / STOP}, where the token lies, is not yours alone: "
        f"end that console (kill {read(folder / PAGE)['pid']}) and start it again"
    )


def _actions(where: Path) -> list[Action]:
    from hil.console.forms import actions

    return actions(where)


def _benches() -> tuple[str, ...]:
    from hil.console.forms import benches

    return benches()


def _open(server: Server, folder: Path) -> None:
    """Start serving in a thread, and write PID and port for the process with the STOP button."""
    import os
    import threading

    from hil.console.jobs import identity
    from hil.console.json_files import put_private
    from hil.console.stop_server import PAGE

    threading.Thread(target=server.serve_forever, args=(0.2,), daemon=True).start()
    put_private(folder / PAGE, identity(os.getpid()) | {"port": server.port})


def _stopper(folder: Path, port: int, known: dict[str, Any] | None = None) -> dict[str, Any]:
    """The process with the STOP button: one left running by an earlier console, else a new one.

    Args:
        folder: folder of the console.
        port: TCP port of this computer; 0 for any.
        known: token and cookie of one that died: open browser pages already have them.

    Raises:
        UsageError: the port is taken.
        DataError: it does not start.
    """
    from hil.console.jobs import detached, signal_process
    from hil.console.json_files import put_private, read
    from hil.console.stop_server import ASKED, IDENTITY, PAGE, STOP, runs

    there = read(folder / STOP)
    if runs(there) and port in (0, there["port"]):
        return there
    signal_process({key: there.get(key) for key in IDENTITY}, signal.SIGTERM)  # of another port
    keys = known or {"token": secrets.token_urlsafe(32), "cookie": f"hil_{secrets.token_hex(4)}"}
    for name in (STOP, *((PAGE,) if known is None else ())):
        (folder / name).unlink(missing_ok=True)
    put_private(folder / ASKED, {"port": port, "token": keys["token"], "cookie": keys["cookie"]})
    detached("hil.console.stop_server", folder)
    until_s = time.monotonic() + _START_S
    while not (reported := read(folder / STOP)) and time.monotonic() < until_s:
        time.sleep(_POLL_S)
    if reported.get("error"):
        raise UsageError(f"--port {port}: {reported['error']}", remedy="choose another, or leave --port out")
    if not reported:
        raise DataError(str(folder), "the process that stops what runs did not start; nothing was started")
    return reported


def _farewell(folder: Path) -> None:
    from hil.console import jobs
    from hil.console.not_held_alarm import Alarm

    for line in _alarm(Alarm(folder).not_held()):
        click.echo(f"hil: {line}", err=True)
    running = [job.title for job in jobs.jobs(folder / "jobs") if jobs.alive(job)]
    if running:
        click.echo(
            f"hil: {', '.join(running)} goes on; hil console --stop stops it, hil console shows it", err=True
        )
