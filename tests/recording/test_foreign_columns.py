"""CSV of other programs: columns and units by a mapping, all problems at once, never ignored."""

import json
import math
import re

import numpy as np
import perfect_robot as perfect
import pytest

from hil.cli import main
from hil.core.errors import ConfigError, DataError
from hil.datasets.mapped_recordings import read_mapped
from hil.datasets.topic_map import read_topic_map

COLUMNS = """
schema = 2
[columns]
separator = ";"
t = "zeit"
phi = ["rad vl", "rad hl", "rad hr", "rad vr"]
delta = ["lenk vl", "lenk hl", "lenk hr", "lenk vr"]
w = ["n vl", "n hl", "n hr", "n vr"]
x = "pos x"
y = "pos y"
theta = "winkel"
drive_sign = [1, 1, -1, -1]
steer_zero_rad = [0.1, 0.0, 0.0, -0.2]
[columns.units]
t = "ms"
phi = "deg"
delta = "deg"
w = "rpm"
position = "mm"
theta = "deg"
"""
WHEELS = ("vl", "hl", "hr", "vr")
HEADER = [
    "kommentar",
    "pos y",
    "pos x",
    "winkel",
    *(f"{what} {wheel}" for what in ("n", "lenk", "rad") for wheel in WHEELS),
    "zeit",
]


@pytest.fixture(scope="module")
def drive():
    return perfect.drive(noise=0.0)


def write(path, drive, header=HEADER, spoil=None):
    """A table in a foreign order, with other units, signs, zeros, decimal commas and a column of text."""
    side, zero = np.array([1, 1, -1, -1]), np.array([0.1, 0.0, 0.0, -0.2])
    pose = np.column_stack([np.interp(drive.t_s, drive.truth_s, column) for column in drive.pose.T])
    table = np.column_stack(
        [
            1e3 * pose[:, 1],
            1e3 * pose[:, 0],
            np.degrees(pose[:, 2]),
            drive.rate * side * 60.0 / math.tau,
            np.degrees(drive.delta + zero),
            np.degrees(drive.phi * side),
            1e3 * drive.t_s,
        ]
    )
    lines = [";".join(["gut", *(repr(v).replace(".", ",") for v in row)]) for row in table.tolist()]
    if spoil:
        lines = spoil(lines)
    path.write_text("\n".join([";".join(header), *lines, ""]))
    return path


def mapping(folder, text=COLUMNS):
    path = folder / "columns.toml"
    path.write_text(text)
    return path


def test_the_drive_is_read_back(drive, tmp_path):
    found = read_mapped(write(tmp_path / "curve_1.csv", drive), read_topic_map(mapping(tmp_path)))
    np.testing.assert_allclose(found.wheel_angle_rad, drive.phi, atol=1e-9)
    np.testing.assert_allclose(found.steering_rad, drive.delta, atol=1e-9)
    np.testing.assert_allclose(found.wheel_rate_rad_s, drive.rate, atol=1e-9)
    np.testing.assert_allclose(np.interp(2.0, found.truth_t_s, found.truth_pose[:, 0]), 1.0, atol=0.05)
    np.testing.assert_allclose(found.t_s, drive.t_s, atol=1e-9)


@pytest.mark.parametrize("command", ["evaluate", "replay"])
def test_commands_read_it(drive, tmp_path, capsys, command):
    made, how = write(tmp_path / "curve_1.csv", drive), mapping(tmp_path)
    assert main([command, str(made), "--topics", str(how), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    figures = result["mean"] if command == "evaluate" else result["estimators"]["odometry"]
    assert figures["rmse_position_m"] < 1e-3


def test_without_ground_truth_it_is_replayed(drive, tmp_path, capsys):
    alone = re.sub(r'(x|y|theta) = "(pos .|winkel)"\n', "", COLUMNS)
    made, how = write(tmp_path / "curve_1.csv", drive), mapping(tmp_path, alone)
    assert main(["replay", str(made), "--topics", str(how), "--estimator", "ekf", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["estimators"]["ekf"]["rmse_position_m"] is None
    assert main(["evaluate", str(made), "--topics", str(how)]) == 2


def test_all_problems_come_at_once(drive, tmp_path):
    def text(lines):
        return [*lines[:9], lines[9].rpartition(";")[0] + ";spaet", *lines[10:]]

    header = ["lenk_vl" if name == "lenk vl" else "rad hl" if name == "rad hr" else name for name in HEADER]
    made = write(tmp_path / "curve_1.csv", drive, header, text)
    with pytest.raises(DataError) as caught:
        read_mapped(made, read_topic_map(mapping(tmp_path)))
    for said in (
        r"lacks the column lenk vl \(delta1\), did you mean lenk_vl",
        r"the column rad hl \(phi2\) more than once",
        r"lacks the column rad hr \(phi3\)",
        r"line 11 holds text in the column zeit: 'spaet'",
    ):
        assert re.search(said, caught.value.message)


@pytest.mark.parametrize("command", ["evaluate", "calibrate", "replay"])
def test_all_wrong_units_come_at_once(drive, tmp_path, capsys, command):
    """Three units that the mapping has wrong: each is named, and with the keys that are told it is read."""
    units = {"t": "ms", "phi": "deg", "position": "mm"}
    wrong = COLUMNS
    for key, unit in units.items():
        wrong = wrong.replace(f'{key} = "{unit}"\n', "")
    made, how = write(tmp_path / "curve_1.csv", drive), mapping(tmp_path, wrong)
    assert main([command, str(made), "--topics", str(how)]) == 2
    told = capsys.readouterr().err
    assert all(f"({name})" in told for name in ("t", "phi", "x, y"))
    keys = re.search(r"in \[columns.units\] of --topics that is (.*)", told)[1].replace(", ", "\n")
    assert set(keys.split("\n")) == {f'{key} = "{unit}"' for key, unit in units.items()}
    right = mapping(tmp_path, wrong.replace("[columns.units]", f"[columns.units]\n{keys}"))
    found = read_mapped(made, read_topic_map(right))
    np.testing.assert_allclose(found.wheel_angle_rad, drive.phi, atol=1e-9)


def test_a_wrong_mapping_is_refused_as_a_whole(tmp_path):
    wrong = COLUMNS.replace('"ms"', '"minutes"').replace("drive_sign = [1, 1", "drive_sign = [2, 1")
    with pytest.raises(ConfigError) as caught:
        read_topic_map(mapping(tmp_path, wrong))
    told = "\n".join(caught.value.problems)
    assert "columns.units.t" in told
    assert "columns.drive_sign" in told
    with pytest.raises(ConfigError) as caught:
        read_topic_map(mapping(tmp_path, COLUMNS + '[wheels]\ntopic = "/a"\ndrive = 1\n'))
    with pytest.raises(ConfigError) as caught:
        read_topic_map(mapping(tmp_path, COLUMNS + '[imu]\ntopic = "/imu"\n'))
    assert any("[columns] is for CSV, [imu] for bags" in one for one in caught.value.problems)


def test_our_own_columns_need_none(drive, tmp_path, caplog):
    """Beside bags of a series, as one that was exported; that the mapping is not applied is said."""
    made = perfect.write_csv(tmp_path / "curve_1.csv", drive)
    found = read_mapped(made, read_topic_map(mapping(tmp_path, perfect.MAPPING)))
    np.testing.assert_allclose(found.wheel_angle_rad, drive.phi, atol=1e-9)
    assert f"{made}: --topics is not applied to it" in caplog.text


@pytest.mark.parametrize("command", ["evaluate", "replay", "tune", "calibrate", "export"])
def test_a_mapping_of_topics_is_not_ignored(drive, tmp_path, capsys, command):
    made = write(tmp_path / "curve_1.csv", drive)
    topics = mapping(tmp_path, perfect.MAPPING)
    assert main([command, str(made), "--topics", str(topics)]) == 2
    assert "--topics has no [columns] for it" in capsys.readouterr().err
    bag = perfect.write_bag(tmp_path / "curve_2", perfect.messages(drive))
    assert main([command, str(bag), "--topics", str(mapping(tmp_path))]) == 2
    assert "has [columns], which are for CSV" in capsys.readouterr().err
