"""The sentence that opens a page, and figures beside their limits: they say what happened."""

import pytest

from hil.cli.run import text_of
from hil.config.bench import BenchConfig
from hil.core.clock import MonotonicClock
from hil.procedure import BenchSource, Measurement, procedure
from hil.procedure.result_files import judge
from hil.procedure.runner import RunOptions, run_procedure
from hil.report.result_file import read_result
from hil.report.run_page import write_run_page
from hil.report.run_summary import sentence


def said_of(declared, values, headline=""):
    rows = judge(declared, values, {}, {}, ended=True)
    return sentence({"error": None, "headline": headline, "measurements": rows})


def test_what_was_not_measured_after_a_failure_does_not_count_as_one():
    gap, more = Measurement("gap_width", "m", high=0.005), Measurement("after", "m", high=1.0)
    assert said_of([gap, more], {"gap_width": 0.006}) == (
        "1 of 2 limits failed: gap width 6 mm, at most 5 mm. What comes after that was not measured: after."
    )


@pytest.mark.parametrize("value", [1.0000001, 0.9999999])
def test_a_value_never_reads_like_a_limit_that_it_is_not(tmp_path, value):
    @procedure(name="near", measurements=(Measurement("b/c", "mm", high=1.0),))
    def near(ctx):
        """A hair beside its limit."""
        ctx.measure("b/c", value)

    source = BenchSource(BenchConfig(schema=1, name="bare"))
    options = RunOptions(tmp_path / "run", MonotonicClock(), "2026-01-01", {})
    result = run_procedure(near, source, options)
    outcome = "FAIL" if value > 1.0 else "PASS"
    assert text_of(result).splitlines()[0].split() == [outcome, "b/c", str(value), "mm", "<=", "1"]
    assert f"<td>{value}</td>" in write_run_page(tmp_path / "run").read_text()
    failures = (tmp_path / "run" / "junit.xml").read_text().count(f"{value} mm, expected &lt;= 1 mm")
    assert failures == (outcome == "FAIL")


def test_a_headline_has_no_values_that_are_no_numbers(tmp_path):
    @procedure(
        name="nan", measurements=(Measurement("end", "mm"),), headline=lambda v: f"Ends {v['end']} off."
    )
    def nan(ctx):
        """Measures no number."""
        ctx.measure("end", float("nan"))

    source = BenchSource(BenchConfig(schema=1, name="bare"))
    run_procedure(nan, source, RunOptions(tmp_path / "out", MonotonicClock(), "2026-01-01", {}))
    assert read_result(tmp_path / "out")["headline"] == ""
