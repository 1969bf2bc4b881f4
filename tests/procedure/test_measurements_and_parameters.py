"""Limits decide, and nothing else; parameters are typed and all their faults are named at once."""

import inspect
import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, Field

from hil.core.errors import ConfigError, UsageError
from hil.procedure import Measurement, Verdict, procedure
from hil.procedure.measurements import worst
from hil.procedure.parameters import as_dict, make_parameters, split_settings


@pytest.mark.parametrize(
    ("value", "verdict"),
    [
        (-0.001, "FAIL"),
        (0.0, "MARGINAL"),
        (0.999, "MARGINAL"),
        (1.0, "PASS"),
        (9.0, "PASS"),
        (9.5, "MARGINAL"),
        (10.0, "MARGINAL"),
        (10.001, "FAIL"),
        (math.nan, "FAIL"),
        (math.inf, "FAIL"),
        (None, "FAIL"),
    ],
)
def test_a_value_is_judged_by_its_distance_to_the_limits(value, verdict):
    assert Measurement("m", "mm", low=0.0, high=10.0, marginal=1.0).judge(value) is Verdict(verdict)


@pytest.mark.parametrize(
    ("limits", "fails", "marginal", "passes"),
    [({"low": 1.0}, 0.9, 1.1, 9e9), ({"high": 1.0}, 1.1, 0.9, -9e9), ({"high": 0.0}, 0.1, 0.0, -0.5)],
)
def test_one_limit_alone_decides_as_two_do(limits, fails, marginal, passes):
    m = Measurement("m", "mm", marginal=0.2, **limits)
    reported = [m.judge(value).value for value in (fails, marginal, passes)]
    assert (reported, m.limited) == (["FAIL", "MARGINAL", "PASS"], True)
    assert not Measurement("m", "mm").limited


def test_a_measurement_has_a_name():
    with pytest.raises(UsageError, match="a measurement without name"):
        Measurement("", "mm")


@given(st.floats(-1e6, 1e6), st.floats(-1e3, 1e3), st.floats(0.0, 1e3))
def test_inside_the_limits_is_never_a_failure_and_outside_always(value, low, width):
    m = Measurement("m", "mm", low=low, high=low + width)
    assert (m.judge(value) is Verdict.FAIL) == (not low <= value <= low + width)


def test_without_limits_a_value_is_reported_and_a_missing_one_fails():
    assert Measurement("m", "s").judge(1e9) is Verdict.PASS
    assert Measurement("m", "s").judge(None) is Verdict.FAIL


@pytest.mark.parametrize(
    "wrong",
    [
        {"high": 1.0},
        {"unit": "mm", "low": 2.0, "high": 1.0},
        {"unit": "mm", "high": math.inf},
        {"unit": "mm", "high": 1.0, "marginal": -0.1},
        {"unit": "mm", "low": 0.0, "high": 1.0, "marginal": 0.6},
        {"unit": "mm", "marginal": 1.0},
        {"unit": "mm", "high": "1"},
        {"unit": "mm", "low": [1.0]},
        {"unit": "mm", "high": 1.0, "marginal": None},
    ],
)
def test_a_limit_that_means_nothing_is_refused_at_declaration(wrong):
    with pytest.raises(UsageError, match="measurement 'm'"):
        Measurement("m", **wrong)


def test_a_run_is_worth_its_worst_measurement():
    assert worst([]) is Verdict.PASS
    assert worst([Verdict.PASS, Verdict.MARGINAL]) is Verdict.MARGINAL
    assert worst([Verdict.FAIL, Verdict.PASS]) is Verdict.FAIL


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"name": "Bad name"}, "lower case"),
        ({"name": "x", "needs": ("lidar",)}, "lidar"),
        ({"name": "x", "measurements": (Measurement("a", "s"), Measurement("a", "m"))}, "declared twice"),
        (
            {"name": "x", "measurements": {"a": "s"}},
            "procedure x: measurements is a dict; expected a list of Measurement",
        ),
        ({"name": "x", "parameters": int}, "procedure x: parameters is int; expected a class: a dataclass"),
    ],
)
def test_a_declaration_that_cannot_be_meant_is_refused(wrong, words):
    with pytest.raises(UsageError, match=words):
        procedure(**wrong)


async def waits(ctx):
    """Would have to be awaited."""


def yields(ctx):
    """Would have to be iterated."""
    yield ctx


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (waits, "procedure x is an async function: a call of it runs nothing; expected a plain function"),
        (yields, "procedure x is a generator function .it holds a yield.: a call of it runs nothing"),
        (partial(waits), "procedure x is an async function"),
        (5, "procedure x is a int; expected a plain function of one argument"),
    ],
)
def test_what_a_call_would_not_run_is_no_procedure(body, words):
    with pytest.raises(UsageError, match=words) as caught:
        procedure(name="x")(body)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("body", [lambda ctx: waits(ctx), Mock(return_value=yields(0))])
def test_a_procedure_that_returns_what_was_never_run_does_not_pass(run_small, body):
    result = run_small(procedure(name="x")(body))
    assert (result.verdict.value, result.exit_code) == ("ERROR", 2)
    assert "procedure x returned " in result.error.message
    assert "a call of it runs nothing; expected a plain function" in result.error.message


def test_measurements_that_a_function_declares_wrong_are_reported_with_the_procedure(run_small):
    declared = procedure(name="x", measurements=lambda parameters: None)(lambda ctx: None)
    with pytest.raises(UsageError, match="procedure x: measurements is a NoneType; expected a list of"):
        run_small(declared)


@pytest.mark.parametrize("text", ["bench. =1", "bench..rate_hz=1"])
def test_a_setting_of_the_bench_needs_a_key(text):
    with pytest.raises(UsageError, match=r"names no key of the bench file; expected bench\.KEY=value"):
        split_settings([text])


@dataclass(frozen=True)
class Plain:
    length_m: float = 1.5
    cases: tuple[str, ...] = ("x", "y")
    law: Literal["a", "b"] = "a"
    fast: bool = False
    name: str = "n"


class Strict(BaseModel):
    seeds: int = Field(1, ge=1, le=20)


def test_texts_become_typed_values():
    found = make_parameters(
        Plain, {"length_m": "0.3", "cases": "y, z", "law": "b", "fast": "true", "name": "17"}, "p"
    )
    assert found == Plain(0.3, ("y", "z"), "b", True, "17")
    assert make_parameters(Plain, {"cases": '["only"]'}, "p").cases == ("only",)
    assert make_parameters(Plain, {"cases": "one"}, "p").cases == ("one",)
    assert make_parameters(Strict, {"seeds": "7"}, "p").seeds == 7
    assert as_dict(found)["cases"] == ["y", "z"]


def test_all_wrong_parameters_are_named_at_once():
    with pytest.raises(ConfigError) as caught:
        make_parameters(Plain, {"length_m": "long", "law": "c", "speed": "1"}, "proc")
    text = str(caught.value)
    assert all(word in text for word in ("proc", "length_m", "law", "speed", "length_m, cases, law, fast"))
    with pytest.raises(ConfigError, match="seeds"):
        make_parameters(Strict, {"seeds": "0"}, "proc")


@pytest.mark.parametrize("value", ["-Infinity", math.inf, "[0.1, NaN]"])
def test_a_parameter_that_is_no_finite_number_is_refused(value):
    @dataclass(frozen=True)
    class Lengths:
        length_m: float | tuple[float, ...] = 1.0

    with pytest.raises(ConfigError, match="length_m: must be a finite number"):
        make_parameters(Lengths, {"length_m": value}, "proc")


def test_settings_for_the_bench_are_distinguished():
    parameters, bench = split_settings(["a=1", "bench.loop.rate_hz=50", "b=x=y", "bench.name=it"])
    assert parameters == {"a": "1", "b": "x=y"}
    assert bench == {"loop.rate_hz": 50, "name": "it"}
    with pytest.raises(UsageError, match="key=value"):
        split_settings(["novalue"])


@pytest.mark.parametrize(
    ("value", "what"),
    [
        (np.zeros(3), "an array of shape (3,)"),
        ([1.0, [2.0]], "a list, [1.0, [2.0]]"),
        (None, "a NoneType, None"),
    ],
)
def test_a_value_that_is_not_one_number_is_named_with_the_line_of_the_script(run_small, value, what):
    @procedure(name="wrong", measurements=(Measurement("length", "mm"),))
    def wrong(ctx):
        ctx.measure("length", value)

    result = run_small(wrong)
    line = inspect.getsourcelines(wrong.body)[1] + 2
    assert result.error.kind == "UsageError"
    assert result.error.message == (
        f"measurement 'length' was set to {what} ({Path(__file__).name}, line {line}); expected one number; "
        "measure one element of it, its mean or its largest"
    )


@pytest.mark.parametrize("value", [np.float32(2.0), np.array(2.0), True, 2, np.bool_(True)])
def test_whatever_is_one_number_is_measured(run_small, value):
    @procedure(name="right", measurements=(Measurement("length", "mm"),))
    def right(ctx):
        ctx.measure("length", value)

    assert run_small(right).measurements[0]["value"] == float(value)
