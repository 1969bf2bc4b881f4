"""Each shipped procedure says in a sentence what its run showed, from values that it declares."""

import re

import pytest

from hil.config.loading import load_bench
from hil.procedure.parameters import make_parameters
from hil.procedure.scripts import load_procedure, shipped_names


def values_of(name, value):
    proc = load_procedure(name)
    declared = proc.declared(make_parameters(proc.parameters, {}, name), load_bench(proc.bench))
    return proc, {m.name: value for m in declared}


@pytest.mark.parametrize("name", shipped_names())
def test_a_run_is_summed_up_in_a_sentence(name):
    proc, values = values_of(name, 12.3)
    said = proc.said(values)
    assert re.fullmatch(r"[A-Z0-9].*[^.]\.", said), said
    assert re.search(r"\b1[12](\.\d+)?\b", said), said
    assert proc.said({}) == ""


def test_a_direction_that_is_reversed_is_said():
    proc, values = values_of("bring_up", 1.0)
    assert "went the right way" in proc.said(values)
    assert "1 of their directions are reversed" in proc.said(values | {"drive_FL.straight": -1.0})


def test_a_wheel_that_pushes_elsewhere_went_not_the_right_way():
    proc, values = values_of("bring_up", 1.0)
    off = {"drive_FL.across": 0.25, "drive_BL.across": 0.29}
    assert "answered, and 2 of their directions are not as expected." in proc.said(values | off)
    both = proc.said(values | off | {"drive_BR.straight": -1.0})
    assert "answered, and 1 of their directions are reversed and 2 not as expected." in both


def test_where_nothing_was_moved_nothing_went_the_right_way():
    proc, values = values_of("bring_up", 1.0)
    told = {name: v for name, v in values.items() if not name.startswith(("drive", "steer_"))}
    unmoved = {name: v for name, v in told.items() if not name.endswith("_response")}
    assert "answered, and nothing was moved." in proc.said(unmoved)


def test_a_headline_that_fails_costs_no_results(caplog):
    from hil.procedure import procedure

    broken = procedure(name="broken", headline=lambda values: 1 / 0)(lambda ctx: None)
    assert broken.said({}) == ""
    assert "the headline of broken failed (ZeroDivisionError" in caplog.text
