"""`bench.held` always says what was last found, and a look keeps to its time."""

import math

import pytest

import hil
from hil.config.thrust import TeensyConfig
from hil.core.errors import UsageError
from hil.robot.trajectories import line

SHORT = line((0.0, 0.0, 0.0), (0.03, 0.0, 0.0), duration_s=1.0)


def took_s(bench, look):
    begin_ns = bench.clock.now_ns()
    found = look()
    return (bench.clock.now_ns() - begin_ns) / 1e9, found


def test_held_says_what_was_last_found_or_that_it_was_not_checked():
    bench = hil.open_bench("emulated", seed=3, overrides={"safety.tethered": True})
    assert (bench.held.state, bench.held.opened) == ("not needed", False)
    with bench:
        unseen = [bench.held]
        assert bench.look() is bench.held
        assert bench.held.state == "HELD"
        bench.drive(SHORT, feedback="odometry")
        unseen.append(bench.held)
        bench.look()
        bench.release()
        unseen.append(bench.held)
    for held in unseen:
        assert held.state == "NOT HELD"
        assert "not checked" in held.why
        assert held.opened
        assert not held.lost
        assert held.moved_m is None
    assert "not checked" not in bench.held.why


def test_a_look_keeps_to_its_limit_and_calls_held_only_what_it_knows_by_then():
    with hil.open_bench("emulated", seed=1) as bench:
        bench.drive(SHORT)
        short_s, held = took_s(bench, lambda: bench.look(0.5))
        assert short_s < 0.6
        assert held.state == "NOT HELD"
        long_s, held = took_s(bench, bench.look)
        assert held.state == "HELD"
        again_s, held = took_s(bench, lambda: bench.look(long_s + 0.5))
        assert held.state == "HELD"
        assert again_s < long_s + 0.5


def test_a_limit_that_is_none_is_refused():
    with hil.open_bench("emulated_floor", seed=1) as bench, pytest.raises(UsageError, match="limit_s"):
        bench.look(math.nan)


@pytest.mark.timeout(60)
@pytest.mark.parametrize("cells", [True, pytest.param(False, marks=pytest.mark.long)])
def test_propellers_with_unknown_failure_never_count_and_end_no_look(monkeypatch, cells):
    monkeypatch.setattr(TeensyConfig, "force_lost_after_s", lambda self, force_n, least_n: math.inf)
    less = {} if cells else {"load_cells": None, "adhesion": None}
    with hil.open_bench("emulated", seed=1, overrides=less) as bench:
        bench.drive(SHORT)
        look_s, held = took_s(bench, bench.look)
        assert (held.state, look_s < 1.2) == ("NOT HELD", True)
        closing_s, _ = took_s(bench, bench.close)
    assert closing_s < bench.config.exit.look_after_s + 0.5
    assert bench.held.state == "NOT HELD"
