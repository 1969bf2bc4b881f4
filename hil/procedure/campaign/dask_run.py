"""Runs the cases of a campaign in parallel on Dask: worker processes here, or a cluster elsewhere.

Processes here share the files of this computer. A cluster is sent what it needs, and shares none.
Dask restarts a worker that dies and runs its case again; a case that kills its worker over and over is
given up and the others go on.

Ctrl-C and SIGTERM end the work without messages of Dask: a call of Dask that a signal breaks into leaves
callbacks behind that fail, and a client that leaves while its jobs still run is reported missing with each
result. Both would end as tracebacks in the log.
"""

from __future__ import annotations

import importlib
import logging
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.resource_tracker import ensure_running
from types import FrameType
from typing import TYPE_CHECKING, Any, TypeVar

from hil.core.errors import Aborted, UsageError
from hil.procedure.campaign.worker_files import WorkerFiles
from hil.support.extras import how_to_install

if TYPE_CHECKING:
    from distributed import Client, Future

_STRIKES = (signal.SIGINT, signal.SIGTERM)
_LOOKS, _LOOK_S = 200, 0.05
J = TypeVar("J")
R = TypeVar("R")
_RETRIES = 2
_UNWATCHED = {"distributed.worker.profile.enabled": False, "distributed.admin.tick.interval": "1s"}
"""Dask looks at the stack of each worker a hundred times a second, for a page that is not used here."""


class Strikes:
    """Signals that are put off until Dask is not at work; a second one is not, for Dask may wait in vain.

    What handled them before is called, and raises what ends the work.
    """

    def __init__(self) -> None:
        self._former: dict[int, Any] = {}
        self._put_off: list[int] = []
        self._heard = False

    def __enter__(self) -> Strikes:
        self._former = _handlers()
        for number in self._former:
            signal.signal(number, self._strike)
        return self

    def __exit__(self, *_: object) -> None:
        _put_back(self._former)

    def _strike(self, number: int, frame: FrameType | None) -> None:
        if self._heard or self._put_off:
            self._former[number](number, frame)
        else:
            self._put_off.append(number)

    @contextmanager
    def heard(self) -> Iterator[None]:
        """Within, a signal strikes at once, also one that came before."""
        self._heard = True
        try:
            if self._put_off:
                number = self._put_off.pop()
                self._former[number](number, None)
            yield
        finally:
            self._heard = False


def take_back(client: Client, futures: Sequence[Future]) -> None:
    """Cancel jobs, and wait until the scheduler has done so and lists none of them any more."""
    reached = client.status == "running"
    client.cancel(futures, force=True)
    with suppress(OSError):  # a scheduler that goes meanwhile answers nothing either
        for _ in range(_LOOKS if reached else 0):
            if any(event.get("action") == "cancel" for _, event in client.get_events(client.id)):
                return
            threading.Event().wait(_LOOK_S)
    logging.getLogger("distributed").setLevel(logging.CRITICAL + 1)  # else each lost result is logged


def close_once(stack: ExitStack) -> None:
    """End client and workers; a second signal meanwhile only made Dask wait for them in vain, 10 s long."""
    handlers = _handlers()
    for number in handlers:
        signal.signal(number, signal.SIG_IGN)
    try:
        stack.close()
    finally:
        _put_back(handlers)


def _handlers() -> dict[int, Any]:
    """What signals are handled by here; those that are ignored, or end the process, are left alone."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    found = {number: signal.getsignal(number) for number in _STRIKES}
    return {number: handler for number, handler in found.items() if callable(handler)}


def _put_back(handlers: dict[int, Any]) -> None:
    for number, handler in handlers.items():
        signal.signal(number, handler)


if TYPE_CHECKING:
    from distributed import Client


@dataclass(frozen=True)
class Unable:
    """What `work` returns on a worker of a cluster that can do no job, because its disk is full for example.

    Attributes:
        worker: its address.
        reason: in words, with the address.
    """

    worker: str
    reason: str


def spread(
    work: Callable[[J], R | Unable],
    jobs: Sequence[J],
    *,
    lost: Callable[[J, str], R],
    done: Callable[[R], None],
    workers: int = 2,
    scheduler: str = "",
    parcel: WorkerFiles | None = None,
) -> None:
    """Do all jobs; results come in the order in which they end.

    A worker of a cluster that is `Unable` is named and leaves, and another one does its job.

    Args:
        work: what to do; must be importable by name, and raise nothing that is expected.
        jobs: what to do it with; sent to the workers.
        lost: result of a job whose worker died or that raised, or that no worker could do, with the reason.
        done: called here with every result.
        workers: processes on this computer; 0 works in this one, without Dask.
        scheduler: address of a Dask scheduler to use instead.
        parcel: files that its workers have until the end (`hil.procedure.campaign.remote_workers.luggage`).

    Raises:
        UsageError: Dask is not installed, the scheduler does not answer, or a worker is of another make.
        Aborted: no worker has room for the files, or the scheduler has gone; results that came before have
            been given to `done`.
    """
    if workers == 0 and not scheduler:
        for job in jobs:
            done(_settled(work(job), job, lost))
        return
    check_dask()
    with _client(min(workers, len(jobs)), scheduler) as client, Strikes() as strikes, ExitStack() as stack:
        from distributed import as_completed

        if scheduler:
            _make_ready(client, scheduler, parcel, stack)
        futures = {client.submit(work, job, retries=_RETRIES, pure=False): job for job in jobs}
        try:
            ended = as_completed(list(futures))
            while True:
                with strikes.heard():
                    future = next(ended, None)
                if future is None:
                    break
                if future.cancelled():
                    raise Aborted(f"Dask scheduler {scheduler!r} has gone", remedy="go on with --resume")
                job, error = futures[future], future.exception()
                result = future.result() if error is None else lost(job, _reason(error))
                if isinstance(result, Unable) and _left_to_others(client, result):
                    again = client.submit(work, job, retries=_RETRIES, pure=False)
                    futures[again] = job
                    ended.add(again)
                else:
                    done(_settled(result, job, lost))
                future.release()
        except BaseException:
            take_back(client, list(futures))
            raise


def _settled(result: R | Unable, job: J, lost: Callable[[J, str], R]) -> R:
    """The result of a job that no other worker can do again."""
    return lost(job, result.reason) if isinstance(result, Unable) else result


def _left_to_others(client: Client, unable: Unable) -> bool:
    from hil.procedure.campaign.remote_workers import do_without

    return do_without(client, unable.worker, unable.reason)


def _make_ready(client: Client, scheduler: str, parcel: WorkerFiles | None, stack: ExitStack) -> None:
    """Hold the workers of a cluster against this computer, and send them the files until `stack` ends."""
    from hil.procedure.campaign.remote_workers import carried, check_workers, report_refused

    try:
        check_workers(client, scheduler)
        report_refused(client)
        if parcel is not None:
            stack.enter_context(carried(client, parcel))
    except OSError as error:
        raise UsageError(f"Dask scheduler {scheduler!r} has gone ({error})") from None


def _reason(error: BaseException) -> str:
    if type(error).__name__ == "KilledWorker":
        return "its worker process died, again and again"
    return f"{type(error).__name__}: {error}"


def check_dask() -> None:
    """Raises `UsageError` with what to do where Dask is not installed."""
    try:
        importlib.import_module("distributed")
    except ImportError:
        raise UsageError(
            "a campaign in parallel needs Dask, which is not installed",
            remedy=f"{how_to_install('campaign')}; or use --workers 0",
        ) from None


@contextmanager
def _client(workers: int, scheduler: str) -> Iterator[Client]:
    for name in ("distributed", "distributed.client"):  # Dask gives both a level of their own
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        client = _connected(scheduler, stack) if scheduler else _with_workers(workers, stack)
        try:
            yield client
        finally:
            close_once(stack)


def _connected(scheduler: str, stack: ExitStack) -> Client:
    """A client of a cluster elsewhere, until `stack` ends."""
    from distributed import Client

    try:
        return stack.enter_context(Client(scheduler, timeout=10))
    except (OSError, ValueError) as error:
        raise UsageError(
            f"Dask scheduler {scheduler!r} does not answer ({error})",
            remedy="start `dask scheduler`, and give the address that it prints",
        ) from None


def _with_workers(workers: int, stack: ExitStack) -> Client:
    """A client of processes here, until `stack` ends."""
    from dask import config
    from distributed import Client, LocalCluster

    options: dict[str, Any] = {
        "n_workers": workers,
        "threads_per_worker": 1,
        "processes": True,
        "host": "127.0.0.1",
        "dashboard_address": "127.0.0.1:0",
        "silence_logs": logging.CRITICAL,
        "memory_limit": 0,
    }
    folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="hil-campaign-"))
    try:
        with _interrupts_put_off(), config.set(_UNWATCHED):
            cluster = stack.enter_context(LocalCluster(local_directory=folder, **options))
            return stack.enter_context(Client(cluster))
    except (RuntimeError, OSError) as error:  # a worker that was killed before it had begun
        raise Aborted(f"the workers did not start ({error})", remedy="go on with --resume") from None


@contextmanager
def _interrupts_put_off() -> Iterator[None]:
    """Ctrl-C waits; threads and processes that begin meanwhile, and theirs, never hear of it."""
    ensure_running()  # a process that starts Python's own tracker gets Ctrl-C again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
