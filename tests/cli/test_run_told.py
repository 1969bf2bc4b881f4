"""What `hil run` says at the terminal: why a run ended comes before what it did not measure."""

from hil.cli.run import text_of
from hil.procedure.measurements import Measurement, Verdict
from hil.procedure.results import Failure, Result, judge

HELD = {"state": "NOT HELD", "moved_m": None, "why": "not checked: the bench did not open"}


def lines_of(tmp_path, values, error):
    declared = [Measurement(f"m{k}", "m", high=1.0) for k in range(33)]
    rows = judge(declared, values, {}, {}, error is None)
    verdict = Verdict.PASS if error is None else Verdict.ERROR
    facts = {"held": HELD, "notes": ["This computer was late itself."], "faults_not_begun": []}
    told = text_of(Result("bring_up", verdict, tmp_path, rows, facts, error)).splitlines()
    notes = [line for line in told if line.startswith("note: ")]
    assert notes == ["note: This computer was late itself."] * (error is not None)
    return [line for line in told if line not in notes]


def test_the_reason_comes_first_and_what_was_not_measured_is_one_line(tmp_path):
    error = Failure("DeviceTimeoutError", "adhesion: no VESC answers", "start", 3)
    reason, missing, held, verdict, results = lines_of(tmp_path, {}, error)
    assert reason == "DeviceTimeoutError in 'start': adhesion: no VESC answers"
    assert missing == "NOT MEASURED 33 of 33: the run ended before them"
    assert held.startswith("NOT HELD: not checked")
    assert verdict == "ERROR: bring_up. It ended early, in 'start'."
    assert results == f"results: {tmp_path}"


def test_what_was_measured_before_is_told_value_by_value(tmp_path):
    reason, first, second, missing, *_ = lines_of(tmp_path, {"m0": 0.5, "m7": 2.0}, Failure("X", "y", "z", 3))
    assert reason == "X in 'z': y"
    assert first.split() == ["PASS", "m0", "0.5", "m", "<=", "1"]
    assert second.split()[:2] == ["FAIL", "m7"]
    assert "31 of 33" in missing


def test_a_run_that_ended_well_tells_every_value_and_nothing_of_the_rest(tmp_path):
    *rows, _held, verdict, _results = lines_of(tmp_path, {f"m{k}": 0.5 for k in range(33)}, None)
    assert len(rows) == 33
    assert not any("NOT MEASURED" in row for row in rows)
    assert verdict.startswith(
        "PASS: bring_up. All 33 limits held; nearest to their limits: m0 0.5 m, at most 1 m; m1"
    )


def test_a_fault_that_never_acted_is_told_also_where_all_is_well(tmp_path):
    notes = ["This computer was late itself.", "fault imu:off@1000 never acted: ..."]
    facts = {"held": HELD, "notes": notes, "faults_not_begun": ["imu:off@1000"]}
    told = text_of(Result("bring_up", Verdict.PASS, tmp_path, [], facts, None)).splitlines()
    assert [line for line in told if line.startswith("note: ")] == [f"note: {notes[1]}"]
