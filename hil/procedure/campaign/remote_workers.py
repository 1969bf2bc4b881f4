"""Workers of a Dask cluster elsewhere: they must be of one make with this computer, and are sent the files.

Who cannot be used is named and leaves the cluster; the files go again when the campaign ends.

Needs the extra `campaign`; imported by those that spread work over a scheduler only.
"""

from __future__ import annotations

import asyncio
import logging
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path
from typing import Any

from distributed import Client, Worker, WorkerPlugin, get_worker

from hil.core.errors import Aborted, DataError, UsageError
from hil.procedure.campaign.worker_files import WorkerFiles, unpacked
from hil.support.extras import DISTRIBUTION
from hil.support.versions import make

LOG = logging.getLogger(__name__)

REFUSED = "hil-refused"
"""Topic under which workers that come later tell why they leave again."""
_LEAVE_S = 0.1
_REMEDY = "install the same packages everywhere, e.g. from requirements/ci.lock"


def report_refused(client: Client) -> None:
    """Say here which workers came later and have left again, and why."""
    client.subscribe_topic(REFUSED, lambda event: LOG.warning("%s; it gets no runs", event[1]))


def check_workers(client: Client, scheduler: str) -> None:
    """Refuse a cluster without workers, or with one of another make.

    Raises:
        UsageError: names worker, package and both versions.
    """
    if not client.scheduler_info(n_workers=-1)["workers"]:
        raise UsageError(
            f"Dask scheduler {scheduler!r} has no workers", remedy=f"start some: dask worker {scheduler}"
        )
    _check_scheduler(client, scheduler)
    own = metadata.version(DISTRIBUTION)
    for worker, there in _asked(client, metadata.version, DISTRIBUTION):
        if isinstance(there, BaseException):
            raise UsageError(f"worker {worker}: has no {DISTRIBUTION}", remedy=_REMEDY)
        if there != own:
            raise _other(f"worker {worker}", DISTRIBUTION, there, own)
    here = make()
    for worker, found in _asked(client, make):
        if isinstance(found, BaseException):
            raise UsageError(f"worker {worker}: cannot be used ({found})", remedy=_REMEDY)
        if (other := _difference(f"worker {worker}", found, here)) is not None:
            raise other


def _check_scheduler(client: Client, scheduler: str) -> None:
    """Refuse a scheduler that cannot read what it passes on: it needs this package, too."""
    try:
        there: dict[str, str] = client.run_on_scheduler(make)
    except OSError:
        raise
    except Exception:  # whatever the missing import of another process becomes on its way back
        raise UsageError(
            f"Dask scheduler {scheduler!r} has no {DISTRIBUTION}, or another one",
            remedy=f"start it where it is installed: {_REMEDY}",
        ) from None
    if (other := _difference(f"Dask scheduler {scheduler!r}", there, make())) is not None:
        raise other


def _asked(client: Client, what: Callable[..., Any], *arguments: str) -> list[tuple[str, Any]]:
    """What every worker answers, or the error that it raises; those that have gone meanwhile are left out."""
    answers = client.run(what, *arguments, on_error="return")
    return [(worker, found) for worker, found in answers.items() if not isinstance(found, OSError)]


def _difference(who: str, there: dict[str, str], here: dict[str, str]) -> UsageError | None:
    """What refuses a process by the first package of another version; None for one of the same make."""
    differing = (name for name, version in here.items() if there.get(name) != version)
    name = next(differing, None)
    return None if name is None else _other(who, name, str(there.get(name)), here[name])


def _other(who: str, name: str, there: str, here: str) -> UsageError:
    return UsageError(
        f"{who}: has {name} {there}, this computer {here}: results would not repeat", remedy=_REMEDY
    )


@contextmanager
def carried(client: Client, parcel: WorkerFiles) -> Iterator[None]:
    """Have every worker keep the files of a campaign, until it ends in whatever way.

    Raises:
        Aborted: no worker has room for them; names each.
    """
    try:
        client.register_plugin(Luggage(parcel))
        _leave_out_full(client, parcel.name)
        yield
    finally:
        if client.status == "running":  # a scheduler that has gone would be waited for
            with suppress(OSError, LookupError, ValueError, asyncio.TimeoutError):  # of workers that leave
                client.unregister_worker_plugin(parcel.name)


def _leave_out_full(client: Client, name: str) -> None:
    """Do without the workers that could not keep the files."""
    answers = _asked(client, lacking, name)
    full = {worker: why for worker, why in answers if why}
    if full and len(full) == len(answers):
        raise Aborted(
            f"no worker can keep the files of this campaign: {'; '.join(map(str, full.values()))}",
            remedy="make room there, then go on with --resume",
        )
    for worker, why in full.items():
        do_without(client, worker, str(why))


def do_without(client: Client, worker: str, why: str) -> bool:
    """Name a worker that can do no run, and have it leave; the last one stays, and the answer is False."""
    known = client.scheduler_info(n_workers=-1)["workers"]
    if not set(known) - {worker}:
        return False
    if worker in known:
        LOG.warning("%s; it gets no more runs, and ends", why)
        client.retire_workers([worker])
    return True


class Luggage(WorkerPlugin):  # type: ignore[misc]  # distributed has no types
    """Has every worker, also one that comes later, unpack the files of a campaign into its own folder."""

    def __init__(self, parcel: WorkerFiles) -> None:
        self.name, self.content, self.make, self.lacking = parcel.name, parcel.content, make(), ""

    def setup(self, worker: Worker) -> None:
        """Unpack; a worker that came later and has other versions reports what differs, and leaves.

        `lacking` says afterwards why the files could not be written, and is empty where they were.

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
        """Leave nothing behind."""
        shutil.rmtree(Path(worker.local_directory) / self.name, ignore_errors=True)


def luggage(name: str) -> Path:
    """Where the worker that asks keeps the files of a campaign."""
    return Path(get_worker().local_directory) / name


def lacking(name: str, dask_worker: Worker) -> str:
    """Why a worker could not keep the files of a campaign, with its address; empty where it has them."""
    return str(getattr(dask_worker.plugins.get(name), "lacking", ""))


def address() -> str:
    """Of the worker that asks."""
    return str(get_worker().address)
