"""Most cycles late: the session says so while it runs and at its end, with what to do about the cause."""

import logging

import pytest

from hil.cli.live import _text
from hil.loop.timing import LateWarning, LoopStatistics, advice


def statistics(cycles, late, work_ms):
    found = LoopStatistics(cycles=cycles, late=late)
    for _ in range(cycles):
        found.add({"work": int(1e6 * work_ms)})
    return found


@pytest.mark.parametrize(
    ("late", "work_ms", "said"),
    [
        (4, 3.0, None),
        (62, 3.0, "62 % of the cycles began late: other programs"),
        (62, 11.0, "62 % of the cycles began late: one takes 11.0 ms of 10.0 ms; lower loop.rate_hz"),
    ],
)
def test_what_to_do_depends_on_who_takes_the_time(late, work_ms, said):
    reported = advice(statistics(100, late, work_ms).summary(), 100.0)
    assert reported.startswith(said) if said else reported == ""
    assert advice(LoopStatistics().summary(), 100.0) == ""


def test_it_is_said_once_after_two_seconds_and_at_the_end(caplog):
    watch, reported = LateWarning(100.0), statistics(199, 150, 3.0)
    with caplog.at_level(logging.WARNING):
        watch.look(reported)
        assert caplog.messages == []
        reported.cycles += 1
        for _ in range(500):
            watch.look(reported)
            reported.cycles += 1
    (message,) = caplog.messages
    assert message.startswith("75 % of the cycles began late")
    timing = reported.summary()
    summary = {
        "bench": "b",
        "rate_hz": 100.0,
        "ended": "duration",
        "timing": timing,
        "samples": {},
        "pose": None,
        "held": {"state": "HELD", "moved_m": 0.0, "why": "torque on"},
        "advice": advice(timing, 100.0),
    }
    assert "150 late (21.4 %)" in _text(summary)
    assert "21 % of the cycles began late" in _text(summary)
