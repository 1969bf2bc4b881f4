"""What stays of a failed test: with `--hil-keep FOLDER` its recordings, and a page of each.

Every bench that a test opens is recorded while it runs. What a passed test has recorded is removed again.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from hil.core.errors import HilError
from hil.procedure.run_outputs import slug
from hil.recording.mcap_writer import McapRecorder

if TYPE_CHECKING:
    from hil.bench import Bench

_KEPT = pytest.StashKey[list[McapRecorder]]()


def record(item: pytest.Item, bench: Bench, root: str) -> None:
    """Have a bench recorded that a test opens.

    Args:
        item: the test.
        bench: of it, before its devices are opened.
        root: folder of the session; the test gets one of its own in it.
    """
    kept = item.stash.setdefault(_KEPT, [])
    folder = item.config.invocation_params.dir / root / _name(item.nodeid)
    if not kept:
        shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True, exist_ok=True)
    name = f"recording-{len(kept) + 1}.mcap" if kept else "recording.mcap"
    virtual = bench.world is not None
    kept.append(McapRecorder(folder / name, bench.header(), lossless=virtual, on_failure="go-on"))
    bench.add_sink(kept[-1])


def finish(item: pytest.Item, failed: pytest.TestReport | None) -> Iterator[tuple[str, str]]:
    """Keep or remove what was recorded of a test that is over; yields kinds and paths of what is kept.

    Args:
        item: the test, whose benches are closed.
        failed: the report of the phase that failed first, None if the test has passed.
    """
    for recorder in item.stash.get(_KEPT, []):
        recorder.close()
        if failed is None:
            shutil.rmtree(recorder.path.parent, ignore_errors=True)
            continue
        yield "recording", str(recorder.path)
        page = recorder.path.with_suffix(".html")
        try:
            _write_page(page, recorder.path, item.nodeid, _sentence(failed))
        except HilError as error:
            yield "page", f"none ({error})"
        else:
            yield "page", str(page)
    if _KEPT in item.stash:
        del item.stash[_KEPT]


def _name(nodeid: str) -> str:
    """A folder's name: readable, and another one for every test."""
    return f"{slug(nodeid.rpartition('/')[2])}-{hashlib.sha256(nodeid.encode()).hexdigest()[:6]}"


def _sentence(failed: pytest.TestReport) -> str:
    """Where and how a test failed, on one line."""
    crash = getattr(failed.longrepr, "reprcrash", None)
    text = failed.longreprtext if crash is None else f"{crash.path}:{crash.lineno}: {crash.message}"
    return text.strip().partition("\n")[0]


def _write_page(page: Path, recording: Path, title: str, sentence: str) -> None:
    """The page of the longest run in a recording, as it was estimated then.

    Raises:
        DataError: the recording holds no cycle, or the page cannot be written.
    """
    from hil.replay.estimator_comparison import compare_run, table, truth_of
    from hil.replay.recordings import open_recording
    from hil.report.replay_page import write_replay_page

    opened = open_recording(recording)
    run = max(opened.runs, key=lambda found: len(found.records))
    motions = compare_run(run, opened.bench, (), source=str(recording))
    events = [event.message for record in run.records for event in record.events if event.level == "error"]
    write_replay_page(
        page,
        title,
        motions,
        truth_of(next(iter(motions.values()))),
        table(motions),
        [f"The test failed: {sentence}", *opened.problems, *dict.fromkeys(events)],
        on_wall=opened.bench.config.environment.on_wall,
    )
