"""Keeps the recordings of failed tests and a page of each, with `--hil-keep FOLDER`.

Every bench that a test opens is recorded until it is closed. A recording is removed if all tests passed
meanwhile.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from hil.core.errors import HilError
from hil.procedure.run_outputs import slug
from hil.recording.mcap_writer import McapRecorder

if TYPE_CHECKING:
    from hil.bench import Bench


def record(item: pytest.Item, bench: Bench, root: str, others: Sequence[Path], attempt: int) -> McapRecorder:
    """Start to record a bench that a test opens; return the recorder.

    Args:
        item: the test.
        bench: its bench, before the devices are opened.
        root: folder of the session; each attempt at the test gets a subfolder.
        others: unfinished recordings of this session.
        attempt: number of the attempt, from 1; what earlier attempts have left is kept.
    """
    kept, name = item.config.invocation_params.dir / root, _name(item.nodeid)
    folder = kept / (name if attempt == 1 else f"{name}-{attempt}")
    if all(path.parent != folder for path in others):
        for old in [folder, *(kept.glob(f"{name}-*") if attempt == 1 else ())]:
            shutil.rmtree(old, ignore_errors=True)
    folder.mkdir(parents=True, exist_ok=True)
    names = ("recording.mcap", *(f"recording-{k + 2}.mcap" for k in range(len(others))))
    path = next(folder / name for name in names if folder / name not in others)
    virtual = bench.world is not None
    recorder = McapRecorder(path, bench.header(), lossless=virtual, on_failure="go-on")
    bench.add_sink(recorder)
    return recorder


def finish(
    recorder: McapRecorder, title: str, facts: Sequence[str], failed: str | None, start: Path
) -> Iterator[tuple[str, str]]:
    """Keep or remove the recording of a closed bench; yield kinds and paths of kept files.

    Args:
        recorder: recorder of the bench.
        title: title of the page.
        facts: texts on the page: how to repeat the test, and how it ended.
        failed: sentence on the first failure, None if no test has failed.
        start: folder to which paths below it are relative.

    Yields:
        `recording` and `page` with a path; `no page` with the reason if the page cannot be written.
    """
    recorder.close()
    if failed is None:
        recorder.path.unlink(missing_ok=True)
        with suppress(OSError):  # the folder holds another recording
            recorder.path.parent.rmdir()
        return
    yield "recording", _path_of(recorder.path, start)
    page = recorder.path.with_suffix(".html")
    try:
        _write_page(page, recorder.path, title, facts, failed)
    except HilError as error:
        yield "no page", str(error)
    else:
        yield "page", _path_of(page, start)


def _path_of(path: Path, start: Path) -> str:
    """Return a path relative to the folder in which pytest was started, if it lies below it."""
    return str(path.relative_to(start) if path.is_relative_to(start) else path)


def _name(nodeid: str) -> str:
    """Return a readable folder name that is unique for each test."""
    return f"{slug(nodeid.rpartition('/')[2])}-{hashlib.sha256(nodeid.encode()).hexdigest()[:6]}"


def sentence_of(failed: pytest.TestReport) -> str:
    """Return where and how a test failed, on one line."""
    crash = getattr(failed.longrepr, "reprcrash", None)
    text = failed.longreprtext if crash is None else f"{crash.path}:{crash.lineno}: {crash.message}"
    return text.strip().partition("\n")[0]


def _write_page(page: Path, recording: Path, title: str, facts: Sequence[str], sentence: str) -> None:
    """Write the page of the longest run in a recording, with its recorded estimates.

    Raises:
        DataError: the recording holds no cycle, or the page cannot be written.
    """
    from hil.replay.estimator_comparison import compare_run, table, truth_of
    from hil.replay.recordings import open_recording
    from hil.report.replay_page import write_replay_page

    opened = open_recording(recording)
    run = opened.run()
    motions = compare_run(run, opened.bench, (), source=str(recording))
    events = [event.message for record in run.records for event in record.events if event.level == "error"]
    write_replay_page(
        page,
        title,
        motions,
        truth_of(next(iter(motions.values()))),
        table(motions),
        [*opened.problems, *dict.fromkeys(events)],
        facts,
        on_wall=opened.bench.config.environment.on_wall,
        said=f"FAIL: {sentence}",
    )
