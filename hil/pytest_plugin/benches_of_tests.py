"""Tracks the benches that tests open: their properties in reports, and their kept recordings.

A bench may outlive the test that opened it, in a fixture of a module or of the session. How it left the robot
is known when it is closed, and is in the report of the test at whose end this happens.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pytest

from hil.core.event_rows import event_line
from hil.pytest_plugin import ATTEMPT, OF_A_BENCH
from hil.pytest_plugin.bench_selection import properties_of
from hil.pytest_plugin.kept_failures import finish, record, sentence_of

if TYPE_CHECKING:
    from hil.bench import Bench
    from hil.recording.mcap_writer import McapRecorder

_ENDS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that end a process without teardown, as a CI runner, or a terminal that is closed, sends them."""
_CLOSED = ("injected", "held")
"""Properties of a bench that is closed."""
_OPENED = pytest.StashKey["list[OpenedBench]"]()


@dataclass
class OpenedBench:
    """A bench that a test has opened.

    Attributes:
        bench: the bench.
        recorder: its recorder; None without `--hil-keep`.
        failed: sentence on the first failure while it was open.
        title: title of its page: the test that failed, else the test that opened it.
        reported: True if its properties are already in a report.
        told: number of its events that are already in a report.
    """

    bench: Bench
    recorder: McapRecorder | None
    title: str
    failed: str | None = None
    reported: bool = False
    told: int = 0

    def news(self) -> list[str]:
        """Lines about the events that are in no report yet."""
        return [event_line(row) for row in self.bench.seen.rows()[self.told :]]


def seen_by_benches(item: pytest.Item) -> str:
    """Return what the benches of a test have seen, a line for each event."""
    return "\n".join(line for one in item.config.stash.get(_OPENED, []) for line in one.news())


def see(item: pytest.Item, bench: Bench) -> None:
    """Register a bench that a test opens, and record it if requested; from now on no signal skips its end."""
    if _OPENED not in item.config.stash:
        _end_in_order(item.config)
    seen = item.config.stash.setdefault(_OPENED, [])
    folder, recorder = item.config.getoption("hil_keep"), None
    if folder:
        others = [one.recorder.path for one in seen if one.recorder is not None]
        recorder = record(item, bench, folder, others, item.stash[ATTEMPT])
    seen.append(OpenedBench(bench, recorder, item.nodeid))


def end_test(
    item: pytest.Item, report: pytest.TestReport, fixture: Bench | None, failed: pytest.TestReport | None
) -> list[str]:
    """Add to the last report of a test the benches that it opened or closed, and their kept files.

    Args:
        item: the test.
        report: report of its teardown.
        fixture: its bench from the fixture `bench`, None without one.
        failed: report of the first failed phase, None if the test has passed.

    Returns:
        A line on each kept file.
    """
    seen = item.config.stash.get(_OPENED, [])
    groups = [[entry for entry in report.user_properties if entry[0] in OF_A_BENCH]]
    kept: list[str] = []
    for one in list(seen):
        if failed is not None and one.failed is None:
            one.failed, one.title = sentence_of(failed), item.nodeid
        news, still = one.news(), one.bench.is_open
        report.user_properties += [("event", line) for line in news]
        one.told += len(news)
        if one.bench is not fixture and not (still and one.reported):
            _add(report, groups, properties_of(one.bench))
            one.reported = True
        if still:
            continue
        seen.remove(one)
        if one.recorder is not None:
            for name, text in _finished(one, item.config):
                kept.append(f"{one.title}: {f'no page ({text})' if name == 'no page' else text}")
                if name != "no page":
                    report.user_properties.append((name, text))
    return kept


def _finished(one: OpenedBench, config: pytest.Config) -> Iterator[tuple[str, str]]:
    """Finish the recording of a bench; yield kinds and paths of the kept files."""
    assert one.recorder is not None
    facts = [f"{name.replace('_', ' ')}: {value}" for name, value in properties_of(one.bench)]
    return finish(one.recorder, one.title, facts, one.failed, config.invocation_params.dir)


def _add(
    report: pytest.TestReport, groups: list[list[tuple[str, object]]], entries: Sequence[tuple[str, object]]
) -> None:
    """Add the properties of a bench under separate names; do not repeat those of a bench already reported.

    Args:
        report: report of the test.
        groups: properties of each reported bench; updated in place.
        entries: properties of this bench.
    """
    for group in groups:
        is_closed = any(name in _CLOSED for name, _ in group)
        there = {(name, str(value)) for name, value in group}
        missing = [entry for entry in entries if (entry[0], str(entry[1])) not in there]
        if not missing or (group and not is_closed and all(name in _CLOSED for name, _ in missing)):
            report.user_properties += missing
            group += missing
            return
    if not groups[0]:
        groups.clear()
    groups.append(list(entries))
    number = f"_{len(groups)}" if len(groups) > 1 else ""
    report.user_properties += [(f"{name}{number}", value) for name, value in entries]


def _end_in_order(config: pytest.Config) -> None:
    """Let SIGTERM and SIGHUP end this session as Ctrl-C does: benches are closed, robots looked at.

    Later ones are ignored. A signal that somebody handles or ignores already is left alone.
    """
    if threading.current_thread() is not threading.main_thread():
        return
    ours = [number for number in _ENDS if signal.getsignal(number) is signal.SIG_DFL]

    process = os.getpid()

    def end(number: int, _frame: object) -> None:
        if os.getpid() != process:  # a child that was forked meanwhile ends as it would without this
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
            return
        for each in ours:
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt(signal.Signals(number).name)

    def put_back() -> None:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)

    for number in ours:
        signal.signal(number, end)
    config.add_cleanup(put_back)


def end_session(config: pytest.Config, *, interrupted: bool) -> list[str]:
    """Finish the recordings of benches that no test has closed.

    Args:
        config: configuration of the session.
        interrupted: True if the session was ended from outside: such recordings are kept.

    Returns:
        Sentences on how the benches of an interrupted session were left, and on what was kept; else nothing.
    """
    lines = []
    for one in config.stash.get(_OPENED, []):
        if interrupted:
            one.failed = one.failed or "the session was interrupted"
            lines.append(f"{one.title}: {one.bench.held}")
        if one.recorder is not None:
            lines += [f"{one.title}: {text}" for _, text in _finished(one, config)]
    return lines if interrupted else []
