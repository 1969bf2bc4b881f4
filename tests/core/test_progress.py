"""Progress: what is said on a terminal and elsewhere, and the time that is left."""

import pytest

from hil.cli.progress import reporting
from hil.core.clock import NS_PER_S
from hil.support.progress import WHOLE, Pace


class Waiting:
    """A host clock that passes when asked to."""

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


def test_an_estimate_that_has_run_out_is_none():
    """Work that takes longer than it seemed is not said to be over in a moment."""
    clock = Waiting()
    pace = Pace(clock)
    pace.update(0, 3)
    clock.s += 4.0
    pace.update(2, 3)
    assert pace.left_s == pytest.approx(2.0)
    clock.s += 2.1
    assert pace.left_s is None
    clock.s += 20.0
    pace.update(2, 3)
    assert pace.left_s == pytest.approx(26.1 / 2)


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


def test_nothing_is_left_of_what_is_done():
    clock = Waiting()
    pace = Pace(clock)
    pace.update(0, 2)
    clock.s += 10.0
    pace.update(2, 2)
    assert pace.left_s is None
