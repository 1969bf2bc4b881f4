"""Runs one case of a campaign, here or on a worker, and makes its row of the table."""

import errno
import itertools
import logging
import os
import shlex
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hil.campaign.cases import Case
from hil.campaign.dask_run import Unable
from hil.campaign.table import Row, missing
from hil.campaign.worker_files import packed, unpacked
from hil.config.loading import path_keys
from hil.core.clock import MonotonicClock, local_time
from hil.core.errors import EXIT_ABORTED, ConfigError, HilError, RecordingError
from hil.core.interfaces import Sink
from hil.core.known_names import LAWS
from hil.core.result_names import JOURNAL, LOST
from hil.faults.files import read_faults
from hil.procedure.bench_source import BenchSource
from hil.procedure.declaration import Procedure
from hil.procedure.interrupts import PATIENCE_S, Interrupts
from hil.procedure.operator import Answers, Terminal, tell
from hil.procedure.parameters import split_settings
from hil.procedure.procedure_lookup import file_and_name, load_procedure
from hil.procedure.run_journal import read_journal
from hil.procedure.run_outputs import Keep
from hil.procedure.run_result import KEEPING
from hil.procedure.runner import RunOptions, run_procedure
from hil.report.result_reader import read_result
from hil.report.run_page import write_run_page

_CASE: ContextVar[str] = ContextVar("case", default="")
"""Case of the current thread: a worker may have several threads, each with its own run."""


class _Named(logging.LogRecord):
    def __init__(self, *arguments: Any, **more: Any) -> None:
        super().__init__(*arguments, **more)
        self._case = _CASE.get()

    def getMessage(self) -> str:
        """Return the message, prefixed with the case of the thread that logged it."""
        text = super().getMessage()
        return f"{self._case}: {text}" if self._case else text


@contextmanager
def named_in_log(case: str) -> Iterator[None]:
    """Prefix what this thread logs in the block with the name of the case."""
    logging.setLogRecordFactory(_Named)
    before = _CASE.set(case)
    try:
        yield
    finally:
        _CASE.reset(before)


FINISHED = ("PASS", "MARGINAL", "FAIL", "ERROR")
_FULL = tuple(os.strerror(code) for code in (errno.ENOSPC, errno.EDQUOT, errno.EROFS))


@dataclass(frozen=True)
class Setup:
    """Settings that all cases share, as text from the command line.

    Attributes:
        controller, ros2_domain: options of `hil run`.
        keep: `all` files of a run, or `results` without recordings and figures.
        places: text that names a file -> path of the file on the worker; any other text is
            itself the path.
    """

    script: str
    bench: str | None
    emulate: str | None
    settings: tuple[str, ...]
    faults: tuple[str, ...]
    calibration: str | None
    answers: str | None
    keep: Keep = "all"
    controller: str | None = None
    ros2_domain: int | None = None
    places: Mapping[str, str] = field(default_factory=dict)

    def source(self, proc: Procedure, case: Case) -> tuple[BenchSource, dict[str, str]]:
        """Return bench and parameters of one case."""
        parameters, overrides = self.split(case)
        for key in set(path_keys(key.partition(".")[0] for key in overrides)) & set(overrides):
            overrides[key] = self.at(str(overrides[key]))
        law, own = (self.controller, "") if self.controller in LAWS else (None, self.controller or "")
        if law is not None:
            overrides = {**overrides, "control.law": law}
        source = BenchSource(
            self.at(self.bench or proc.bench),
            emulate=self.emulate,
            seed=case.seed,
            faults=read_faults(map(self.at, self.all_faults(case))),
            overrides=overrides,
            calibration=Path(self.at(self.calibration)) if self.calibration else None,
            controller=own,
        )
        return source, parameters

    def at(self, text: str) -> str:
        """Return the path of a file in this process."""
        return self.places.get(text, text)

    def split(self, case: Case) -> tuple[dict[str, str], dict[str, object]]:
        """Return parameters and bench overrides of one case."""
        return split_settings(self.all_settings(case))

    def all_settings(self, case: Case) -> tuple[str, ...]:
        """Return the settings of one case, as `key=value`."""
        return (*self.settings, *(f"{key}={value}" for key, value in case.settings if key != "fault"))

    def all_faults(self, case: Case) -> tuple[str, ...]:
        """Return the faults of one case: specs, and files of timelines."""
        return (*self.faults, *(v for key, v in case.settings if key == "fault" and v != "none"))

    def command(self, case: Case) -> str:
        """Return the command line that repeats one case alone."""
        options = [("bench", self.bench), ("emulate", self.emulate), ("calibration", self.calibration)]
        options += [("set", text) for text in self.all_settings(case)]
        options += [("fault", text) for text in self.all_faults(case)]
        options += [("controller", self.controller), ("answers", self.answers), ("seed", str(case.seed))]
        if self.ros2_domain is not None:
            options.append(("ros2-domain", str(self.ros2_domain)))
        given = [part for name, text in options if text for part in (f"--{name}", text)]
        return shlex.join(["hil", "run", self.script, *given])


@dataclass(frozen=True)
class Job:
    """One case with everything that a worker needs to run it.

    Attributes:
        folder: results folder.
        input_files: name of the parcel with the files on a remote worker; empty for a local worker.
    """

    setup: Setup
    case: Case
    folder: str
    input_files: str = ""


@dataclass(frozen=True)
class Delivery:
    """Result of a remote run: its row, and the packed files of its results folder."""

    row: Row
    content: bytes = b""


def run_case(job: Job, publish: Callable[[Mapping[str, Any]], Sink] | None = None) -> Row:
    """Run one case in a worker that shares this computer's files; `publish` as for `BenchSource`."""
    try:
        tree = _result(job, publish)
    except HilError as error:
        if _is_unwritten(error, job.folder):
            return lost(job, str(error))
        return _failed(job, "ERROR", str(error), error.exit_code)
    if reason := _unwritten(tree, job.folder):
        return lost(job, reason)
    return _row(job, tree)


def run_case_elsewhere(job: Job) -> Delivery | Unable:
    """Run one case in a worker without shared files; return `Unable` if its disk is full."""
    from distributed import Reschedule, get_worker

    from hil.campaign.remote_workers import address, input_folder, lacking

    def lost_here(reason: object) -> Delivery | Unable:
        message = f"worker {address()}: {reason}"
        full = any(words in message for words in _FULL)
        return Unable(address(), message) if full else Delivery(lost(job, message))

    here = input_folder(job.input_files)
    if not here.exists():
        if why := lacking(job.input_files, get_worker()):
            return Unable(address(), why)
        raise Reschedule  # to another worker: this one has other versions and is leaving
    try:
        with tempfile.TemporaryDirectory(prefix="run-", dir=here.parent) as folder:
            places = {text: str(here / name) for text, name in job.setup.places.items()}
            own = replace(
                job, setup=replace(job.setup, places=places), folder=str(Path(folder) / job.case.name)
            )
            try:
                tree = _result(own)
            except HilError as error:
                if _is_unwritten(error, folder):
                    return lost_here(error)
                return Delivery(_failed(job, "ERROR", str(error), error.exit_code))
            if reason := _unwritten(tree, own.folder):
                return lost_here(reason)
            return Delivery(_row(job, tree), packed(Path(own.folder)))
    except OSError as error:
        return lost_here(error)
    finally:
        _forget_modules(here)


def _forget_modules(folder: Path) -> None:
    """Unload modules from a folder, so that a later campaign can import its own modules of the same names."""
    for name, module in tuple(sys.modules.items()):
        if str(getattr(module, "__file__", None) or "").startswith(str(folder)):
            del sys.modules[name]
    sys.path[:] = [place for place in sys.path if not place.startswith(str(folder))]


def _is_unwritten(error: HilError, folder: str) -> bool:
    """Whether the error means that results could not be written: the computer's fault, not the robot's."""
    return isinstance(error, RecordingError) or folder in str(error)


def _unwritten(tree: Mapping[str, Any], folder: str) -> str:
    """Return why results could not be written, from the content of `result.json`; empty if they were."""
    from hil.procedure.run_result import KEEPING

    first, late = tree.get("error"), tree.get("teardown_errors", ())
    for error in ([first] if first else []) + [e for e in late if e["step"] == KEEPING]:
        own = error["type"] == "DataError" and str(error["message"]).startswith(folder)
        if own or error["type"] == "RecordingError":
            return str(error["message"])
    return ""


def arrived(delivery: Delivery) -> Row:
    """Unpack the results of a remote run into its results folder; return its row."""
    if delivery.content:
        unpacked(delivery.content, Path(delivery.row.folder))
    return delivery.row


def _result(job: Job, publish: Callable[[Mapping[str, Any]], Sink] | None = None) -> dict[str, Any]:
    """Run one case; return the content of its `result.json`."""
    setup, folder = job.setup, Path(job.folder)
    script, name = file_and_name(setup.script)
    proc = load_procedure(":".join(filter(None, (setup.at(script), name))))
    source, parameters = setup.source(proc, job.case)
    operator = Terminal() if setup.answers is None else Answers(Path(setup.at(setup.answers)))
    options = RunOptions(
        folder=folder,
        clock=MonotonicClock(),
        parameters=parameters,
        operator=operator,
        started=local_time(),
        resume=_begun(folder),
        keep=setup.keep,
        interrupts=Interrupts(tell, PATIENCE_S),
    )
    with named_in_log(job.case.name):
        result = run_procedure(proc, replace(source, publish=publish), options)
    if not any(error.step == KEEPING for error in result.teardown_errors):
        write_run_page(folder)
    return result.to_json()


def _begun(folder: Path) -> bool:
    """Whether a folder holds a run that can be resumed to the same outcome; else rename the folder."""
    if not folder.exists() or not any(folder.iterdir()):
        return False
    try:
        past = read_journal(folder / JOURNAL)
    except ConfigError:
        past = None
    if past is None or past.left_behind:
        places = (folder.with_name(f"{folder.name}.damaged-{k}") for k in itertools.count(1))
        folder.rename(next(place for place in places if not place.exists()))
        return False
    return True


def finished(job: Job) -> Row | None:
    """Return the row of a case that reached its verdict earlier; None if it did not, or lacked disk space."""
    try:
        tree = read_result(Path(job.folder))
    except HilError:
        return None
    return _row(job, tree) if tree["verdict"] in FINISHED and not _unwritten(tree, job.folder) else None


def _row(job: Job, tree: dict[str, Any]) -> Row:
    kept = ("unit", "value", "outcome", "low", "high")
    error = tree.get("error") or next(iter(tree.get("teardown_errors", [])), None)
    return Row(
        job.case,
        job.folder,
        tree["verdict"],
        tree["exit_code"],
        tree.get("duration_s") or 0.0,
        {row["name"]: {k: row[k] for k in kept} | {"missing": missing(row)} for row in tree["measurements"]},
        "" if error is None else f"{error['type']} in {error['step']!r}: {error['message']}",
        tuple(tree["faults_not_met"]),
    )


def _failed(job: Job, verdict: str, reason: str, code: int) -> Row:
    return Row(job.case, job.folder, verdict, code, 0.0, {}, reason)


def lost(job: Job, reason: str) -> Row:
    """Return the row of a case whose worker was lost or had no room for the results."""
    return _failed(job, LOST, reason, EXIT_ABORTED)
