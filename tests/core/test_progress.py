"""Progress: what is said on a terminal and elsewhere, and the time that is left."""

import io

import pytest

from hil.cli.progress import reporting
from hil.vocabulary.clock import NS_PER_S
from hil.vocabulary.progress import WHOLE, Pace, in_words


class Waiting:
    """A host clock that passes when told."""

    def __init__(self):
        self.s = 100.0

    def now_ns(self):
        return round(self.s * NS_PER_S)

    def sleep_until_ns(self, t_ns):
        raise AssertionError("progress does not wait")


def test_time_left_follows_the_pace_and_counts_down():
    clock = Waiting()
    pace = Pace(clock)
    pace.update(0, 30)
    assert pace.left_s is None
    clock.s += 60.0
    pace.update(10, 30)
    assert pace.left_s == pytest.approx(120.0)
    clock.s += 20.0
    assert pace.left_s == pytest.approx(100.0)
    pace.update(10, 60)
    assert pace.left_s == pytest.approx(80.0 / 10 * 50)


def test_what_was_done_before_says_nothing_about_the_pace():
    """A resumed run takes 20 of 30 from its journal at once; the others take 6 s each."""
    clock = Waiting()
    pace = Pace(clock)
    for done in range(21):
        pace.update(done, 30)
        clock.s += 0.01
    clock.s += 6.0
    pace.update(21, 30)
    assert pace.left_s == pytest.approx(9 * 6.0, rel=0.01)


def test_work_in_quick_pieces_has_a_pace_too():
    clock = Waiting()
    pace = Pace(clock)
    for done in range(11):
        pace.update(done, 30)
        clock.s += 0.5
    assert pace.left_s == pytest.approx(20 * 0.5, rel=0.2)


@pytest.mark.parametrize(
    ("left_s", "words"),
    [
        (None, ""),
        (1.0, "a few seconds left"),
        (38.0, "about 40 s left"),
        (89.9, "about 90 s left"),
        (121.0, "about 2 min left"),
        (3000.0, "about 50 min left"),
        (9000.0, "about 2.5 h left"),
    ],
)
def test_left_in_words(left_s, words):
    assert in_words(left_s) == words


def test_plain_lines_tell_the_whole_runs_time_left(capsys):
    clock = Waiting()
    with reporting(clock=clock) as report:
        for done in range(0, 31, 6):
            report(WHOLE, 30 + done, 72)
            report("round 2 of 2 to 4, recording", done, 30)
            clock.s += 36.0
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "round 2 of 2 to 4, recording: 0/30"
    assert lines[2] == "round 2 of 2 to 4, recording: 12/30, about 3 min left in all"
    assert lines[-1] == "round 2 of 2 to 4, recording: 30/30, about 70 s left in all"
    assert not any(line.startswith(WHOLE) for line in lines)


def plain_lines(capsys, most, total):
    """What is said of the first runs of all, each of which takes 2 s."""
    clock = Waiting()
    with reporting(clock=clock) as report:
        for done in range(most + 1):
            report("runs", done, total)
            clock.s += 2.0
    return capsys.readouterr().err.splitlines()


def test_plain_lines_come_by_tenths_with_the_pieces_own_time_left(capsys):
    lines = plain_lines(capsys, 100, 100)
    assert len(lines) == 11
    assert lines[5] == "runs: 50/100, about 100 s left"
    assert lines[-1] == "runs: 100/100"


def test_plain_lines_of_long_work_come_twice_a_minute(capsys):
    """A tenth of a thousand runs takes minutes."""
    lines = plain_lines(capsys, 90, 1000)
    assert [line.split(",")[0] for line in lines] == [f"runs: {done}/1000" for done in range(0, 91, 15)]


def test_a_step_is_named_once(capsys):
    with reporting(clock=Waiting()) as report:
        report("fit 1", 0, 1)
        report("fit 1", 1, 1)
        report("hold (from the journal)", 1, 1)
    assert capsys.readouterr().err.splitlines() == ["fit 1", "hold (from the journal)"]


def test_nothing_is_left_of_what_is_done():
    clock = Waiting()
    pace = Pace(clock)
    pace.update(0, 2)
    clock.s += 10.0
    pace.update(2, 2)
    assert pace.left_s is None


def test_a_terminal_shows_bars_with_the_time_left(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr("sys.stderr", screen := Terminal())
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    clock = Waiting()
    with reporting(clock=clock) as report:
        report(WHOLE, 0, 60)
        report("round 1 of 2, recording", 0, 30)
        clock.s += 60.0
        report(WHOLE, 12, 60)
        report("round 1 of 2, recording", 12, 30)
    shown = screen.getvalue()
    assert "about 4 min left" in shown
    assert "about 90 s left" in shown
    assert "12/30" in shown
