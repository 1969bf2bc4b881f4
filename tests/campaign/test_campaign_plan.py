"""Which cases a campaign has, and what its statistics say."""

import csv

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from hil.campaign import Axis, Case, Row, expand, parse_axis, parse_seeds, summarise, write_csv
from hil.campaign.table import NEVER_SET, wilson
from hil.core.errors import UsageError


@pytest.mark.parametrize(("text", "seeds"), [("0:4", (0, 1, 2, 3)), ("7", (7,)), ("3,1:3, 5", (3, 1, 2, 5))])
def test_seeds(text, seeds):
    assert parse_seeds(text) == seeds


@pytest.mark.parametrize(
    "text", ["", "a", "4:2", "3:3", "1,,2", "-1", "0:99999999999", "9223372036854775808"]
)
def test_seeds_that_mean_nothing(text):
    with pytest.raises(UsageError, match="--seeds"):
        parse_seeds(text)


def test_a_range_without_a_seed_is_named():
    with pytest.raises(UsageError, match=r"--seeds '1,5:5': no seed lies in 5:5; expected 0:10 for 0 to 9"):
        parse_seeds("1,5:5")


@pytest.mark.parametrize("text", ["1,1", "5,3:7"])
def test_a_seed_is_named_once(text):
    with pytest.raises(UsageError, match=r"[135] is named twice; name each value once"):
        parse_seeds(text)


def test_a_value_is_named_once():
    with pytest.raises(UsageError, match=r"--vary 'gain=2,1,1': 1 is named twice; name each value once"):
        parse_axis("gain=2,1,1")


@pytest.mark.parametrize(
    ("text", "axis"),
    [
        ("speed=0.1,0.2", Axis("speed", ("0.1", "0.2"))),
        ("corner=[0.1,0.2],[0.3,0.4]", Axis("corner", ("[0.1,0.2]", "[0.3,0.4]"))),
        ("fault=none; imu:drop@1,probability=0.2", Axis("fault", ("none", "imu:drop@1,probability=0.2"))),
        ("bench.name=wall", Axis("bench.name", ("wall",))),
    ],
)
def test_axes(text, axis):
    assert parse_axis(text) == axis


@pytest.mark.parametrize("text", ["speed", "speed=", "=1,2", "speed= , "])
def test_axes_that_mean_nothing(text):
    with pytest.raises(UsageError, match="--vary"):
        parse_axis(text)


def test_every_combination_has_every_seed():
    cases = expand((1, 2), [Axis("a", ("x", "y")), Axis("b", ("1", "2", "3"))])
    assert len(cases) == len(set(cases)) == 12
    assert cases[0] == Case(1, (("a", "x"), ("b", "1")))
    assert {c.group for c in cases} == {f"a={a}, b={b}" for a in "xy" for b in "123"}
    with pytest.raises(UsageError, match="twice"):
        expand((1,), [Axis("a", ("x",)), Axis("a", ("y",))])
    with pytest.raises(UsageError, match="too many"):
        expand(range(1000), [Axis("a", tuple(map(str, range(1000))))])


settings = st.lists(
    st.tuples(st.sampled_from("ab"), st.text(min_size=1)), max_size=2, unique_by=lambda p: p[0]
).map(tuple)


@given(st.lists(st.tuples(st.integers(0, 99), settings), max_size=8, unique=True))
def test_names_of_cases_are_folders_and_differ(found):
    names = [Case(*one).name for one in found]
    assert len(set(names)) == len(names)
    for name in names:
        assert name == name.strip()
        assert "/" not in name
        assert name not in ("", ".", "..")
        assert len(name.encode()) < 400


@pytest.mark.parametrize(("good", "total"), [(0, 1), (1, 1), (3, 10), (10, 10), (0, 20), (19, 20)])
def test_the_interval_of_a_share_is_that_of_scipy(good, total):
    oracle = binomtest(good, total).proportion_ci(method="wilson")
    assert wilson(good, total) == pytest.approx((oracle.low, oracle.high), abs=1e-12)


def row(seed, verdict, value, setting="1"):
    measured = {"error": {"unit": "mm", "value": value, "outcome": verdict, "low": None, "high": 3.0}}
    measured["error"]["missing"] = NEVER_SET if value is None else ""
    return Row(Case(seed, (("speed", setting),)), f"runs/{seed}", verdict, 0, 1.0, measured, "")


def test_statistics_by_combination(tmp_path):
    rows = [row(0, "PASS", 1.0), row(1, "MARGINAL", 2.0), row(2, "FAIL", 6.0), row(0, "ERROR", None, "2")]
    first, second = summarise(rows)
    assert (first["group"], first["n"], first["pass_share"]) == ("speed=1", 3, 2 / 3)
    (measured,) = first["measurements"]
    assert (measured["n"], measured["mean"], measured["min"], measured["max"]) == (3, 3.0, 1.0, 6.0)
    assert measured["std"] == pytest.approx(7.0**0.5)
    assert second["measurements"][0]["mean"] is None
    assert second["verdicts"] == {"ERROR": 1}
    write_csv(tmp_path / "rows.csv", rows)
    with (tmp_path / "rows.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["error (mm)"] for line in lines] == ["1.0", "2.0", "6.0", ""]
    assert [line["speed"] for line in lines] == ["1", "1", "1", "2"]
