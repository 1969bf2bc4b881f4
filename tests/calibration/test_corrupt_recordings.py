"""Corrupt recordings are named and left out of a calibration; good ones are not accused."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.calibration.calibration_file import read_calibration
from hil.calibration.corrupt_recordings import corrupt
from hil.calibration.synthetic import MOTIONS, hidden_robot, make_set
from hil.cli import main
from hil.datasets.nominal_robot import Nominal
from hil.datasets.read import read_recordings
from tests.calibration.spoilt_sets import KINDS, make_drives
from tests.selected import every


def named(drives, folder):
    """Names of the recordings that are left out, read or fitted, or whose clock was corrected."""
    for one in drives:
        one.write(folder)
    unusable = {}
    recordings = read_recordings([folder], unusable=unusable)
    moved = {one.name for one in recordings if abs(np.median(one.truth_t_s) - np.median(one.t_s)) > 0.2}
    return {Path(file).stem for file in unusable} | set(corrupt(recordings, Nominal())) | moved


def spoilt(drives):
    return {one.name for one in drives if one.spoilt}


def hil(capsys, *words):
    capsys.readouterr()
    code = main([*map(str, words), "--json"])
    reported = capsys.readouterr()
    return code, json.loads(reported.out), reported.err


@pytest.mark.parametrize("kind", every(2, KINDS))
def test_the_spoilt_recording_and_no_other_is_named(tmp_path, kind):
    drives = make_drives(300 + KINDS.index(kind), (kind,))
    assert named(drives, tmp_path) == spoilt(drives)


@pytest.mark.parametrize("seed", every(2, [310, 311, 312, 313]))
def test_of_good_recordings_none_is_named(tmp_path, seed):
    assert named(make_drives(seed), tmp_path) == set()


@pytest.mark.parametrize("contact", ["viscous", "coulomb"])
def test_neither_slip_bursts_nor_another_law_of_contact_are_taken_for_damage(contact):
    assert (
        corrupt(make_set(hidden_robot(7, contact=contact), 7, repetitions=2, slip_share=0.5), Nominal()) == {}
    )


@pytest.mark.long
@pytest.mark.parametrize("first", range(2000, 2050, 10))
def test_of_many_sets_all_that_is_spoilt_and_hardly_anything_good_is_named(tmp_path, first):
    """Of ten kinds two in most sets: 16 spoilt recordings among about 100 good ones."""
    tally = Counter()
    for seed in range(first, first + 10):
        second = [KINDS[(seed // 10 + 3 * seed) % len(KINDS)]] if seed % 5 < 3 else []
        drives = make_drives(seed, (KINDS[seed % len(KINDS)], *second))
        folder = tmp_path / str(seed)
        folder.mkdir()
        found = named(drives, folder)
        tally.update(spoilt=len(spoilt(drives)), good=len(drives) - len(spoilt(drives)))
        tally.update(missed=len(spoilt(drives) - found), accused=len(found - spoilt(drives)))
    assert (tally["spoilt"], tally["missed"]) == (16, 0)
    assert tally["accused"] <= 0.01 * tally["good"] + 0.5


@pytest.mark.parametrize("kind", ["mirrored", "degrees"])
def test_a_calibration_is_what_it_is_without_the_recording_that_it_names(tmp_path, capsys, kind):
    """Whether it could be read or not: a calibration that is written has passed, with exit code 0."""
    drives = make_drives(320, (kind,))
    (bad,) = spoilt(drives)
    for name in ("with", "without"):
        (tmp_path / name).mkdir()
        for one in drives:
            if name == "with" or not one.spoilt:
                one.write(tmp_path / name)
    out = tmp_path / "calibration.toml"
    words = ["--model", "exact", "--no-validation"]
    reported = {name: hil(capsys, "calibrate", tmp_path / name, *words) for name in ("with", "without")}
    assert (reported["with"][0], reported["without"][0]) == (0, 0)
    assert reported["with"][1]["verdict"] == "PASS"
    found, alone = reported["with"][1], reported["without"][1]
    for key in ("parameters", "std", "cost_before", "cost_after", "recordings"):
        assert found[key] == alone[key], key
    (key,) = found["rejected"]
    assert Path(key).stem == bad
    assert found["rejected_because"][key]
    assert found["weights"][key] == 0.0
    assert any(line.startswith(f"{key}: left out: ") for line in found["warnings"])
    assert f"warning: {key}: left out: " in reported["with"][2]
    assert main(["calibrate", str(tmp_path / "with"), *words, "--out", str(out)]) == 0
    assert bad in capsys.readouterr().out
    assert set(read_calibration(out).recordings) == {one.name for one in drives if not one.spoilt}


def mirror(one):
    return replace(one, truth=one.truth * (1.0, -1.0, -1.0))


def test_where_most_recordings_are_mirrored_they_are_refused(tmp_path, capsys):
    for one in make_drives(321):
        mirror(one).write(tmp_path)
    code, reported, _ = hil(capsys, "calibrate", tmp_path, "--no-validation")
    assert code == 2
    assert "the wheels contradict the ground truth" in reported["error"]["message"]


def test_as_many_wrong_files_as_right_ones_are_refused(tmp_path, capsys):
    for k, one in enumerate(make_drives(322)[:8]):
        (one if k % 2 else replace(one, angle=np.degrees(one.angle))).write(tmp_path)
    code, reported, _ = hil(capsys, "calibrate", tmp_path, "--no-validation")
    assert code == 2
    assert "degrees" in reported["error"]["message"]


def exchanged(one):
    order = [3, 1, 2, 0]
    return replace(
        one, wheel_angle_rad=one.wheel_angle_rad[:, order], steering_rad=one.steering_rad[:, order]
    )


def test_wheels_in_another_order_throughout_are_no_fault_of_the_recordings_that_show_it():
    """Lines do not show it: they do not contradict the curves."""
    data = make_set(hidden_robot(5), 5, ("line_x", "line_y", *MOTIONS[2:4]), 2)
    assert corrupt([exchanged(one) for one in data], Nominal()) == {}


def test_another_body_in_all_drives_of_one_motion_is_told_and_the_set_refused(tmp_path, capsys):
    drives = make_drives(323)
    motion = next(d.name for d in drives if "rotation" in d.name or "circle" in d.name).rsplit("_", 1)[0]

    def carried(one):
        c, s = np.cos(one.truth[:, 2]), np.sin(one.truth[:, 2])
        return replace(one, truth=one.truth + 0.3 * np.column_stack([c, s, 0.0 * c]))

    for one in drives:
        (carried(one) if one.name.startswith(motion) else one).write(tmp_path)
    code, found, _ = hil(capsys, "calibrate", tmp_path, "--no-validation")
    assert code == 2
    said = found["error"]["message"]
    assert "tracks a point" in said
    assert [d.name for d in drives if d.name in said] == [d.name for d in drives if d.name.startswith(motion)]
