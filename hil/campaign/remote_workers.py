"""Prepares the workers of a remote Dask cluster: checks their versions and sends them the input files.

An unusable worker is logged and leaves the cluster. The files are removed when the campaign ends.

Needs the extra `campaign`; imported only when a scheduler is used.
"""

import asyncio
import logging
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path
from typing import Any

from distributed import Client, Worker, WorkerPlugin, get_worker

from hil.campaign.worker_files import WorkerFiles, unpacked
from hil.core.errors import Aborted, DataError, UsageError
from hil.support.extras import DISTRIBUTION
from hil.support.versions import make

LOG = logging.getLogger(__name__)

REFUSED = "hil-refused"
"""Topic on which a worker that joins later reports why it leaves again."""
_LEAVE_S = 0.1
_REMEDY = "install the same packages everywhere, e.g. from requirements/ci.lock"


def report_refused(client: Client) -> None:
    """Log in this process which late workers have left again, and why."""
    client.subscribe_topic(REFUSED, lambda event: LOG.warning("%s; it gets no runs", event[1]))


def check_workers(client: Client, scheduler: str) -> None:
    """Reject a cluster without workers, or with a worker that has other versions.

    Raises:
        UsageError: no worker, or a worker differs; names worker, package and both versions.
    """
    if not client.scheduler_info(n_workers=-1)["workers"]:
        raise UsageError(
            f"Dask scheduler {scheduler!r} has no workers", remedy=f"start some: dask worker {scheduler}"
        )
    _check_scheduler(client, scheduler)
    own = metadata.version(DISTRIBUTION)
    for worker, there in _run_on_all(client, metadata.version, DISTRIBUTION):
        if isinstance(there, BaseException):
            raise UsageError(f"worker {worker}: has no {DISTRIBUTION}", remedy=_REMEDY)
        if there != own:
            raise _other(f"worker {worker}", DISTRIBUTION, there, own)
    here = make()
    for worker, found in _run_on_all(client, make):
        if isinstance(found, BaseException):
            raise UsageError(f"worker {worker}: cannot be used ({found})", remedy=_REMEDY)
        if (other := _difference(f"worker {worker}", found, here)) is not None:
            raise other


def _check_scheduler(client: Client, scheduler: str) -> None:
    """Reject a scheduler without this package: it could not deserialise the messages that it forwards."""
    try:
        there: dict[str, str] = client.run_on_scheduler(make)
    except OSError:
        raise
    except Exception:  # the remote import error may arrive as any type
        raise UsageError(
            f"Dask scheduler {scheduler!r} has no {DISTRIBUTION}, or another one",
            remedy=f"start it where it is installed: {_REMEDY}",
        ) from None
    if (other := _difference(f"Dask scheduler {scheduler!r}", there, make())) is not None:
        raise other


def _run_on_all(client: Client, what: Callable[..., Any], *arguments: str) -> list[tuple[str, Any]]:
    """Call a function on every worker; return (worker, result or error), without workers that have ended."""
    answers = client.run(what, *arguments, on_error="return")
    return [(worker, found) for worker, found in answers.items() if not isinstance(found, OSError)]


def _difference(process: str, there: dict[str, str], here: dict[str, str]) -> UsageError | None:
    """Return the error for the first package whose version differs; None if all versions agree."""
    differing = (name for name, version in here.items() if there.get(name) != version)
    name = next(differing, None)
    return None if name is None else _other(process, name, str(there.get(name)), here[name])


def _other(process: str, name: str, there: str, here: str) -> UsageError:
    return UsageError(
        f"{process}: has {name} {there}, this computer {here}: results would not repeat", remedy=_REMEDY
    )


@contextmanager
def files_on_workers(client: Client, parcel: WorkerFiles) -> Iterator[None]:
    """Keep the files of a campaign on every worker until the block ends, also by an error.

    Raises:
        Aborted: no worker has room for the files; names each worker.
    """
    try:
        client.register_plugin(InputFilesPlugin(parcel))
        _leave_out_full(client, parcel.name)
        yield
    finally:
        if client.status == "running":  # else the call would wait for an ended scheduler
            with suppress(OSError, LookupError, ValueError, asyncio.TimeoutError):  # a worker may be leaving
                client.unregister_worker_plugin(parcel.name)


def _leave_out_full(client: Client, name: str) -> None:
    """Retire the workers that could not keep the files."""
    answers = _run_on_all(client, lacking, name)
    full = {worker: why for worker, why in answers if why}
    if full and len(full) == len(answers):
        raise Aborted(
            f"no worker can keep the files of this campaign: {'; '.join(map(str, full.values()))}",
            remedy="make room there, then go on with --resume",
        )
    for worker, why in full.items():
        do_without(client, worker, str(why))


def do_without(client: Client, worker: str, why: str) -> bool:
    """Log and retire a worker that cannot do runs. Return False, and keep it, if it is the last worker."""
    known = client.scheduler_info(n_workers=-1)["workers"]
    if not set(known) - {worker}:
        return False
    if worker in known:
        LOG.warning("%s; it gets no more runs, and ends", why)
        client.retire_workers([worker])
    return True


class InputFilesPlugin(WorkerPlugin):  # type: ignore[misc]  # distributed has no types
    """Unpacks the files of a campaign into a folder of every worker, also of a worker that joins later."""

    def __init__(self, parcel: WorkerFiles) -> None:
        self.name, self.content, self.make, self.lacking = parcel.name, parcel.content, make(), ""

    def setup(self, worker: Worker) -> None:
        """Unpack the files. A late worker with other versions reports the difference and leaves.

        `lacking` is then the reason if the files could not be written, else empty.

        Raises:
            UsageError: the worker has other packages or another Python.
        """
        if (other := _difference(f"worker {worker.address}", make(), self.make)) is not None:
            worker.log_event(REFUSED, str(other))
            worker.loop.call_later(_LEAVE_S, worker.close)
            raise other
        folder = Path(worker.local_directory) / self.name
        try:
            if not folder.exists():
                unpacked(self.content, folder)
        except DataError as error:
            self.lacking = f"worker {worker.address}: {error}"

    def teardown(self, worker: Worker) -> None:
        """Remove the files."""
        shutil.rmtree(Path(worker.local_directory) / self.name, ignore_errors=True)


def input_folder(name: str) -> Path:
    """Return the folder in which the calling worker keeps the files of a campaign."""
    return Path(get_worker().local_directory) / name


def lacking(name: str, dask_worker: Worker) -> str:
    """Return why a worker could not keep the files of a campaign, with its address; empty if it could."""
    return str(getattr(dask_worker.plugins.get(name), "lacking", ""))


def address() -> str:
    """Return the address of the calling worker."""
    return str(get_worker().address)
