"""Most cycles late: the session says so while it runs and at its end, with what to do about the cause."""

import logging

import pytest

from hil.loop.timing import LateWarning, LoopStatistics, advice


def statistics(cycles, late, work_ms):
    found = LoopStatistics(cycles=cycles, late=late)
    for _ in range(cycles):
        found.add({"work": int(1e6 * work_ms)})
    return found


@pytest.mark.parametrize(
    ("late", "work_ms", "said"),
    [(4, 3.0, None), (62, 3.0, "other programs"), (62, 11.0, "lower loop.rate_hz")],
)
def test_what_to_do_depends_on_who_takes_the_time(late, work_ms, said):
    reported = advice(statistics(100, late, work_ms).summary(), 100.0)
    assert said in reported if said else reported == ""
    assert advice(LoopStatistics().summary(), 100.0) == ""


def test_it_is_said_once_after_two_seconds(caplog):
    watch, reported = LateWarning(100.0), statistics(199, 150, 3.0)
    with caplog.at_level(logging.WARNING):
        watch.look(reported)
        assert caplog.messages == []
        for _ in range(500):
            reported.cycles += 1
            watch.look(reported)
    assert len(caplog.messages) == 1
