"""Runs the cases of a campaign in parallel on Dask: local worker processes, or a remote cluster.

Local processes share the files of this computer. A cluster shares none and receives what it needs.
Dask restarts a worker that dies and repeats its case. A case that kills its worker repeatedly is given up;
the other cases go on.

Ctrl-C, SIGTERM and SIGHUP are handled outside of Dask calls, because they would cause tracebacks in the log:
an interrupted Dask call leaves callbacks behind that fail, and a client that disconnects while its jobs run
is reported missing with each result.
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

from hil.campaign.worker_files import WorkerFiles
from hil.core.errors import Aborted, UsageError
from hil.support.extras import how_to_install
from hil.support.interrupt_signals import STOPS

if TYPE_CHECKING:
    from distributed import Client, Future

_LOOKS, _LOOK_S = 200, 0.05
J = TypeVar("J")
R = TypeVar("R")
_RETRIES = 2
_UNWATCHED = {"distributed.worker.profile.enabled": False, "distributed.admin.tick.interval": "1s"}
"""Turn off Dask's profiler: it samples each worker's stack a hundred times a second, for an unused page."""


class DeferredSignals:
    """Defer the first signal until no Dask call runs; handle a second one at once, as a Dask call may hang.

    A signal is passed to its former handler, whose exception ends the work.
    """

    def __init__(self) -> None:
        self._former: dict[int, Any] = {}
        self._put_off: list[int] = []
        self._at_once = False

    def __enter__(self) -> DeferredSignals:
        self._former = _handlers()
        for number in self._former:
            signal.signal(number, self._strike)
        return self

    def __exit__(self, *_: object) -> None:
        _put_back(self._former)

    def _strike(self, number: int, frame: FrameType | None) -> None:
        if self._at_once or self._put_off:
            self._former[number](number, frame)
        else:
            self._put_off.append(number)

    @contextmanager
    def delivered(self) -> Iterator[None]:
        """Handle every signal within this block at once, also one that was deferred."""
        self._at_once = True
        try:
            if self._put_off:
                number = self._put_off.pop()
                self._former[number](number, None)
            yield
        finally:
            self._at_once = False


def take_back(client: Client, futures: Sequence[Future]) -> None:
    """Cancel jobs and wait until the scheduler reports the cancellation."""
    reached = client.status == "running"
    client.cancel(futures, force=True)
    with suppress(OSError):  # the scheduler may end meanwhile
        for _ in range(_LOOKS if reached else 0):
            if any(event.get("action") == "cancel" for _, event in client.get_events(client.id)):
                return
            threading.Event().wait(_LOOK_S)
    logging.getLogger("distributed").setLevel(logging.CRITICAL + 1)  # else each lost result is logged


def close_once(stack: ExitStack) -> None:
    """End client and workers; ignore signals meanwhile, since one would make Dask wait 10 s for nothing."""
    handlers = _handlers()
    for number in handlers:
        signal.signal(number, signal.SIG_IGN)
    try:
        stack.close()
    finally:
        _put_back(handlers)


def _handlers() -> dict[int, Any]:
    """Return the signals that have Python handlers, with these; ignored and default actions are left out."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    found = {number: signal.getsignal(number) for number in STOPS}
    return {number: handler for number, handler in found.items() if callable(handler)}


def _put_back(handlers: dict[int, Any]) -> None:
    for number, handler in handlers.items():
        signal.signal(number, handler)


if TYPE_CHECKING:
    from distributed import Client


@dataclass(frozen=True)
class Unable:
    """Returned by `work` on a cluster worker that cannot do any job, for example because its disk is full.

    Attributes:
        worker: address of the worker.
        reason: text that includes the address.
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
    """Do all jobs; return the results in the order in which the jobs end.

    A cluster worker that returns `Unable` is logged and retired; another worker does its job.

    Args:
        work: function to call with each job; must be importable by name, and must not raise expected errors.
        jobs: arguments of `work`; sent to the workers.
        lost: function that makes the result of a job that raised or that no worker could do or finish, from
            the reason.
        done: called in this process with every result.
        workers: processes on this computer; 0 runs all jobs in this process, without Dask.
        scheduler: address of a Dask scheduler to use instead.
        parcel: files that cluster workers keep until the end (`remote_workers.input_folder`).

    Raises:
        UsageError: Dask is not installed, the scheduler does not answer, or a worker has other versions.
        Aborted: no worker has room for the files, or the scheduler has ended; `done` has received the results
            up to then.
    """
    if workers == 0 and not scheduler:
        for job in jobs:
            done(_settled(work(job), job, lost))
        return
    check_dask()
    with (
        _client(min(workers, len(jobs)), scheduler) as client,
        DeferredSignals() as deferred,
        ExitStack() as stack,
    ):
        from distributed import as_completed

        if scheduler:
            _make_ready(client, scheduler, parcel, stack)
        futures = {client.submit(work, job, retries=_RETRIES, pure=False): job for job in jobs}
        try:
            ended = as_completed(list(futures))
            while True:
                with deferred.delivered():
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
    """Return the result of a job; an `Unable` becomes a lost job, since no other worker can repeat it."""
    return lost(job, result.reason) if isinstance(result, Unable) else result


def _left_to_others(client: Client, unable: Unable) -> bool:
    from hil.campaign.remote_workers import do_without

    return do_without(client, unable.worker, unable.reason)


def _make_ready(client: Client, scheduler: str, parcel: WorkerFiles | None, stack: ExitStack) -> None:
    """Check that cluster workers have this computer's versions; send them the files until `stack` ends."""
    from hil.campaign.remote_workers import check_workers, files_on_workers, report_refused

    try:
        check_workers(client, scheduler)
        report_refused(client)
        if parcel is not None:
            stack.enter_context(files_on_workers(client, parcel))
    except OSError as error:
        raise UsageError(f"Dask scheduler {scheduler!r} has gone ({error})") from None


def _reason(error: BaseException) -> str:
    if type(error).__name__ == "KilledWorker":
        return "its worker process died repeatedly"
    return f"{type(error).__name__}: {error}"


def check_dask() -> None:
    """Raise `UsageError` with a remedy if Dask is not installed."""
    try:
        importlib.import_module("distributed")
    except ImportError:
        raise UsageError(
            "a campaign in parallel needs Dask, which is not installed",
            remedy=f"{how_to_install('campaign')}; or use --workers 0",
        ) from None


@contextmanager
def _client(workers: int, scheduler: str) -> Iterator[Client]:
    for name in ("distributed", "distributed.client"):  # Dask sets a log level for both
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        client = _connected(scheduler, stack) if scheduler else _with_workers(workers, stack)
        try:
            yield client
        finally:
            close_once(stack)


def _connected(scheduler: str, stack: ExitStack) -> Client:
    """Return a client of a remote cluster, closed when `stack` ends."""
    from distributed import Client

    try:
        return stack.enter_context(Client(scheduler, timeout=10))
    except (OSError, ValueError) as error:
        raise UsageError(
            f"Dask scheduler {scheduler!r} does not answer ({error})",
            remedy="start `dask scheduler`, and give the address that it prints",
        ) from None


def _with_workers(workers: int, stack: ExitStack) -> Client:
    """Start local worker processes and return their client; both end with `stack`."""
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
    except (RuntimeError, OSError) as error:  # a worker was killed while it started
        raise Aborted(f"the workers did not start ({error})", remedy="go on with --resume") from None


@contextmanager
def _interrupts_put_off() -> Iterator[None]:
    """Block what a terminal sends to all its processes, also in threads and processes started meanwhile."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
    ensure_running()  # starting Python's resource tracker would unblock SIGINT
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
