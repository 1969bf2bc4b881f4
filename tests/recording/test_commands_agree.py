"""One recording through every command that reads it: where they print the same quantity, it is the same."""

import json
from dataclasses import replace

import numpy as np
import perfect_robot as perfect
import pytest
from perfect_robot import MAPPING
from test_faulty_sources import stepped
from test_gaps_and_starts import rolling, with_gaps

from hil.cli import main
from tests.selected import every

SAME = ("rmse_position_m", "rmse_theta_rad", "final_position_m")
CASES = {
    "whole": lambda: perfect.drive(),
    "gaps": lambda: with_gaps(perfect.drive()),
    "late start": lambda: perfect.drive().truth_where(perfect.drive().truth_s > 0.8),
    "rolling, gaps": lambda: with_gaps(rolling(perfect.drive())),
    "slow": lambda: perfect.drive(truth_hz=10.0),
    "slow, rolling, gaps": lambda: with_gaps(rolling(perfect.drive(truth_hz=4.0))),
}


@pytest.fixture
def said(capsys):
    def said(*command, code=0):
        assert main([*map(str, command), "--json"]) == code
        return json.loads(capsys.readouterr().out)

    return said


def agree(said, tmp_path, data, *more):
    """Evaluation, replay, calibration and export of one recording; its rows by evaluation."""
    table = said("evaluate", data, *more)
    (row,) = table["motions"].values()
    replayed = said("replay", data, "--estimator", "odometry", *more)["estimators"]["odometry"]
    for key in SAME:
        assert replayed[key] == pytest.approx(row[key], abs=1e-9)
    fitted = said("calibrate", data, "--model", "exact", "--no-validation", *more)
    assert fitted["cost_before"] == pytest.approx(table["cost"], rel=1e-9)
    return row


@pytest.mark.parametrize("case", every(5, CASES))
def test_of_a_table_whatever_the_order_of_its_rows(tmp_path, said, case):
    found = CASES[case]()
    rows = len(found.t_s) + len(found.truth_s)
    data = perfect.write_csv(tmp_path / "curve_1.csv", found)
    first = agree(said, tmp_path, data)
    mixed = np.argsort(np.arange(rows) + np.random.default_rng(1).uniform(0.0, 6.0, rows))
    other = perfect.write_csv(tmp_path / "curve_2.csv", found, order=mixed)
    assert said("evaluate", other)["motions"]["curve"] == first


@pytest.mark.parametrize("case", every(5, CASES))
def test_of_a_bag_and_of_the_table_that_is_exported_from_it(tmp_path, said, case):
    found = CASES[case]()
    topics = tmp_path / "topics.toml"
    topics.write_text(MAPPING)
    bag = perfect.write_bag(tmp_path / "curve_1", perfect.messages(found))
    row = agree(said, tmp_path, bag, "--topics", topics)
    said("export", bag, "--topics", topics, "--out", tmp_path / "table_1.csv")
    table = said("evaluate", tmp_path / "table_1.csv")["motions"]["table"]
    for key in SAME[:2]:
        assert table[key] == pytest.approx(row[key], abs=1e-4)


def test_of_two_parts(tmp_path, said):
    topics = tmp_path / "topics.toml"
    topics.write_text(MAPPING)
    bag = perfect.write_bag(tmp_path / "curve_1", stepped(perfect.drive(), 8.0, 0.5))
    row = said("evaluate", bag, "--topics", topics)
    assert row["motions"]["curve"]["n"] == 2
    longest = said("replay", bag, "--topics", topics, "--estimator", "odometry")["estimators"]["odometry"]
    assert longest["rmse_position_m"] == pytest.approx(np.sqrt(2.0) * 2e-4, rel=0.4)
    assert row["motions"]["curve"]["rmse_position_m"] == pytest.approx(np.sqrt(2.0) * 2e-4, rel=0.4)
    assert main(["export", str(bag), "--topics", str(topics)]) == 2


def test_of_tuning_on_a_bag_and_on_the_table_that_is_exported_from_it(tmp_path, said):
    topics, table = tmp_path / "topics.toml", tmp_path / "curve_2.csv"
    topics.write_text(MAPPING)
    folder = tmp_path / "bags"
    bag = perfect.write_bag(folder / "curve_1", perfect.messages(perfect.drive()))
    said("export", bag, "--topics", topics, "--out", table)
    few = ("--topics", topics, "--parameter", "wheels.per_sqrt_m", "--evaluations", "2")
    found = said("tune", folder, "--check", table, *few)
    likely = [found[of]["before"]["likelihood"] for of in ("held_out", "fitted")]
    assert likely[0] == pytest.approx(likely[1], rel=0.02)


def test_of_a_heading_with_the_other_sign(tmp_path, capsys):
    topics, whole = tmp_path / "topics.toml", perfect.drive()
    topics.write_text(MAPPING)
    mirrored = replace(whole, pose=whole.pose * (1.0, 1.0, -1.0))
    bag = perfect.write_bag(tmp_path / "curve_1", perfect.messages(mirrored))
    for command in ("evaluate", "replay", "tune"):
        assert main([command, str(bag), "--topics", str(topics)]) == 2
        assert "the heading (theta) had the other sign" in capsys.readouterr().err


@pytest.mark.parametrize(
    "drives", [("w2", "w1", "w3", "w4"), ("w1", "w3", "w2", "w4"), ("w4", "w2", "w3", "w1")]
)
def test_drives_exchanged_in_the_mapping_are_refused_by_every_command(tmp_path, said, drives):
    topics = tmp_path / "topics.toml"
    named = ", ".join(f'"{name}"' for name in drives)
    topics.write_text(MAPPING.replace('"w1", "w2", "w3", "w4"', named))
    bag = perfect.write_bag(tmp_path / "curve_1", perfect.messages(perfect.drive()))
    for command in ("evaluate", "calibrate", "replay"):
        assert "phi" in json.dumps(said(command, bag, "--topics", topics, code=2))
