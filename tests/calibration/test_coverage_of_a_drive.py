"""A drive of which wheels or ground truth saw only a part: refused, named, or, at rest, of no matter."""

import gzip

import numpy as np
import pytest

from hil.cli import main
from hil.core.errors import DataError
from hil.datasets.cleaning import Log
from hil.datasets.drive_coverage import covered
from hil.datasets.nominal_robot import Nominal
from hil.datasets.plain_csv import write_plain
from hil.datasets.read import read_recordings
from hil.datasets.wheel_log import build_recording
from hil.robot.kinematics import NOMINAL_RADIUS_M

SPEED_M_S = 0.1
DRIVES = ((3.0, 8.0), (11.0, 16.0))
"""Two lines of half a metre each; the robot rests before, between and after."""
END_S = 20.0


def driven(wheels=(0.0, END_S), truth=(0.0, END_S), *, drives=DRIVES, carried=0.0):
    """Two lines as both saw them in these times; carried on, m, in the last two seconds."""
    wheel_s, truth_s = np.arange(*wheels, 0.02), np.arange(*truth, 0.01)
    way = [sum(np.clip(t - a, 0.0, b - a) for a, b in drives) * SPEED_M_S for t in (wheel_s, truth_s)]
    angle = np.outer(way[0] / NOMINAL_RADIUS_M, np.ones(4))
    x_m = way[1] + carried * np.clip(truth_s - (END_S - 2.0), 0.0, 2.0) / 2.0
    pose = np.column_stack([x_m, np.zeros((len(x_m), 2))])
    pose += np.random.default_rng(1).normal(0.0, 2e-4, pose.shape)
    return build_recording(
        "line_x_1",
        Log(wheel_s, np.column_stack([angle, np.zeros_like(angle)])),
        Log(truth_s, pose),
        sources=("odom_1.csv", "abs_1.csv"),
    )


SEEN_IN_PART = {
    "wheels cut under way": (
        {"wheels": (0.0, 6.0)},
        r"odom_1\.csv: the wheels cover 6\.0 s, the ground truth 20\.0 s: the ground truth moves 0\.70 m in "
        r"the 14\.0 s after the last row of the wheels",
    ),
    "truth cut under way": (
        {"truth": (0.0, 6.0)},
        r"abs_1\.csv: .*wheels roll 0\.70 m in the 14\.0 s after the last row of the ground truth",
    ),
    "truth late": ({"truth": (5.0, END_S)}, r"wheels roll 0\.19 m in the 5\.0 s before the first row"),
    "wheels late": ({"wheels": (5.0, END_S)}, r"truth moves 0\.20 m in the 5\.0 s before the first row"),
    "truth ends at a stop": ({"truth": (0.0, 9.5)}, "wheels roll 0.50 m in the 10.5 s after"),
    "no drive in the wheels": ({"wheels": (0.0, 2.0)}, "truth moves 1.00 m in the 18.0 s after"),
}


@pytest.mark.parametrize(("seen", "said"), SEEN_IN_PART.values(), ids=SEEN_IN_PART)
def test_a_drive_that_was_seen_in_part_is_refused_with_both_times(seen, said):
    with pytest.raises(DataError, match=said) as error:
        covered(driven(**seen), Nominal())
    assert "cut both to the same time" in error.value.remedy


WHOLE = {
    "whole": {},
    "truth rests longer": {"wheels": (2.5, 17.0)},
    "wheels rest longer": {"truth": (2.5, 17.0)},
    "both cut": {"wheels": (0.0, 6.0), "truth": (0.0, 6.2)},
    "a part in the middle": {"wheels": (5.0, 14.0), "truth": (4.7, 14.3)},
}


@pytest.mark.parametrize("seen", WHOLE.values(), ids=WHOLE)
def test_a_rest_and_ends_near_each_other_are_no_matter(seen):
    assert covered(driven(**seen), Nominal()).repairs == {}


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        (
            {"wheels": (0.0, 17.5), "carried": 0.8},
            "the ground truth moves 0.78 m in the 2.5 s after the last row",
        ),
        (
            {"wheels": (0.0, 9.5), "drives": ((3.0, 8.0), (11.0, 14.0))},
            "the ground truth moves 0.30 m in the 10.5 s after the last row of the wheels",
        ),
        (
            {"truth": (9.0, END_S), "drives": ((4.0, 7.0), (11.0, 16.0))},
            "the wheels roll 0.30 m in the 9.0 s before the first row of the ground truth",
        ),
    ],
    ids=["carried away", "wheels end at a stop", "truth begins at a stop"],
)
def test_what_moves_beyond_a_rest_is_named_and_not_checked(seen, said):
    (what,) = [w for w in covered(driven(**seen), Nominal()).warnings() if "not checked" in w]
    assert what.startswith("line_x_1: 1 stretch of the drive not checked: ")
    assert said in what


@pytest.mark.parametrize(("ends_s", "found"), [(15.69, ""), (15.55, "named"), (15.4, "refused")])
def test_twenty_millimetres_of_a_short_way_may_be_missing(ends_s, found):
    """A drive of 97 cm, of whose end the ground truth lacks 1, 15 or 30 mm, and the rest after it."""
    seen = driven(truth=(0.0, ends_s), drives=((3.0, 8.0), (11.0, 15.7)))
    if found == "refused":
        with pytest.raises(DataError, match=r"wheels roll 0\.03 m"):
            covered(seen, Nominal())
    else:
        assert bool(covered(seen, Nominal()).repairs) is bool(found)


@pytest.mark.parametrize(("lasts_s", "refused"), [(0.4, False), (0.8, True)])
def test_a_cut_under_way_counts_from_half_a_second_on(lasts_s, refused):
    seen = driven(wheels=(0.0, 14.0), truth=(0.0, 14.0 - lasts_s))
    if refused:
        with pytest.raises(DataError, match=r"wheels roll 0\.0[78] m in the 0\.8 s after"):
            covered(seen, Nominal())
    else:
        assert covered(seen, Nominal()).repairs == {}


def test_single_rows_of_ground_truth_that_are_off_at_rest_are_no_motion():
    whole = driven(wheels=(0.0, 17.0))
    pose = whole.truth_pose.copy()
    pose[-150:-148, 0] += 0.028
    again = build_recording(
        "line_x_1",
        Log(whole.t_s, np.column_stack([whole.wheel_angle_rad, whole.steering_rad])),
        Log(whole.truth_t_s, pose),
    )
    assert covered(again, Nominal()).repairs == {"ground-truth rows that leap away and back dropped": 2}


def test_one_file_without_truth_at_its_end_is_refused_by_every_command(tmp_path, capsys):
    path = tmp_path / "line_x_1.csv"
    write_plain(path, driven(truth=(0.0, 6.0)))
    for command in (["evaluate"], ["calibrate", "--no-validation"], ["replay"], ["tune"]):
        assert main([*command, str(path)]) == 2
        reported = capsys.readouterr()
        assert f"{path}: the wheels cover 20.0 s, the ground truth 6.0 s" in reported.err, command
        assert reported.out == ""


def test_halves_of_a_real_recording_are_refused(public_data, tmp_path):
    tables = {}
    for name in ("odom_1.csv", "abs_1.csv"):
        tables[name] = gzip.decompress((public_data / f"{name}.gz").read_bytes()).splitlines(keepends=True)
    for cut, rows, said in (("odom_1.csv", 1500, "66.3 s after"), ("abs_1.csv", 2000, "58.6 s after")):
        for name, lines in tables.items():
            (tmp_path / name).write_bytes(b"".join(lines[:rows] if name == cut else lines))
        with pytest.raises(DataError, match=said):
            read_recordings([tmp_path])
