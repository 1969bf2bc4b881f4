"""Export of recordings, and recordings as input of calibration, from our files and from rosbag2."""

from __future__ import annotations

import csv
import dataclasses
import errno
import itertools
import json
import os
import subprocess
import sys
import weakref

import numpy as np
import pyarrow.parquet
import pytest
from click.testing import CliRunner
from mcap_cases import driving_record
from recorded import recorded

from hil.cli.export import command
from hil.core.errors import DataError, UsageError
from hil.core.signals import SERVOS
from hil.datasets.export import COLUMNS, to_recording, wheel_table, write_table
from hil.datasets.plain_csv import read_plain
from hil.datasets.rosbag import read_bag
from hil.datasets.topic_map import read_topic_map

CYCLES = 300


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("export") / "line_x_1.mcap"
    return recorded(path, map(driving_record, range(CYCLES)), {})


def column(table, name):
    return table[:, COLUMNS.index(name)]


def test_table_holds_the_measured_values():
    records = [driving_record(k) for k in range(60)]
    table = wheel_table(records).values
    assert table.shape == (60, len(COLUMNS))
    np.testing.assert_array_equal(
        column(table, "phi2"), [r.inputs.servos[0].position_rad[1] for r in records]
    )
    np.testing.assert_array_equal(
        column(table, "estimate_x_m"), [r.state.pose_body_in_wall[0] for r in records]
    )
    np.testing.assert_allclose(column(table, "t"), 0.01 * np.arange(60))
    np.testing.assert_allclose(column(table, "sigma_x_m"), 0.01)
    # Truth was seen at the wheels' own instants here, so interpolation must return it.
    np.testing.assert_allclose(column(table, "x"), [r.measurements.mocap[0].pose[0] for r in records])


def test_trajectories_are_those_of_the_table(recording, tmp_path):
    done = CliRunner().invoke(
        command, [str(recording), "--format", "tum", "--out", str(tmp_path), "--json"], standalone_mode=False
    )
    files = json.loads(done.output)["files"]
    assert sorted(os.listdir(tmp_path)) == sorted(map(os.path.basename, files))
    table = wheel_table(driving_record(k) for k in range(CYCLES)).values
    for name, first in (("estimate", "estimate_x_m"), ("truth", "x")):
        rows = np.loadtxt(tmp_path / f"{name}.tum")
        np.testing.assert_allclose(rows[:, 0], column(table, "t"), atol=1e-9)
        np.testing.assert_allclose(rows[:, 1], column(table, first), atol=1e-9)


def test_truth_is_not_invented_inside_gaps():
    records = []
    for k in range(60):
        record = driving_record(k)
        if 20 <= k < 40:
            record = dataclasses.replace(
                record, measurements=dataclasses.replace(record.measurements, mocap=())
            )
        records.append(record)
    known = np.isfinite(column(wheel_table(records).values, "x"))
    assert known[:20].all()
    assert not known[20:40].any()
    assert known[40:].all()


def test_no_cycle_stays_in_memory(recording, monkeypatch):
    """Ten minutes had taken 1.5 GB, by `hil export` and by all that evaluates our recordings."""
    alive, most = [], []

    def cycles(*_):
        for k in range(CYCLES):
            record = driving_record.__wrapped__(k)  # which nothing caches
            alive.append(weakref.ref(record.state.pose_body_in_wall))
            most.append(sum(pose() is not None for pose in alive))
            yield record

    wheel_table(cycles())
    monkeypatch.setattr("hil.datasets.export.read_cycles", cycles)
    to_recording(recording)
    assert len(most) == 2 * CYCLES
    assert max(most) < 5


def test_a_table_on_standard_output_is_the_table_alone(recording):
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "hil.cli",
            "export",
            str(recording),
            "--format",
            "csv",
            "--out",
            "/dev/stdout",
        ],
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    head, *rows = csv.reader(done.stdout.splitlines())
    assert tuple(head) == COLUMNS
    assert {len(row) for row in rows} == {len(COLUMNS)}
    assert f"{CYCLES} rows" in done.stderr


def test_csv_and_parquet_hold_the_same_bits(tmp_path):
    records = [driving_record(k) for k in range(40)]
    for k in range(10, 30):  # NaN had stood in the Parquet file, which polars and SQL take for a number
        unseen = dataclasses.replace(records[k].measurements, mocap=())
        records[k] = dataclasses.replace(records[k], measurements=unseen)
    table = wheel_table(records)
    assert (table.values.shape, table.columns, table.cycles) == ((40, len(COLUMNS)), COLUMNS, 40)
    write_table(table, tmp_path / "t.csv", "csv")
    write_table(table, tmp_path / "t.parquet", "parquet")
    from_csv = np.genfromtxt(tmp_path / "t.csv", delimiter=",", names=True)
    from_parquet = pyarrow.parquet.read_table(tmp_path / "t.parquet")
    assert tuple(from_parquet.column_names) == COLUMNS
    for name in COLUMNS:
        np.testing.assert_array_equal(from_csv[name], from_parquet[name].to_numpy())
        assert from_parquet[name].null_count == np.isnan(from_csv[name]).sum()
        assert not np.isnan(from_parquet[name].drop_null().to_numpy()).any()
    assert from_parquet["x"].null_count == 20
    with pytest.raises(UsageError, match="csv or parquet"):
        write_table(table, tmp_path / "x", "xlsx")
    with pytest.raises(DataError, match="cannot be written"):
        write_table(table, tmp_path / "no" / "x.csv", "csv")


def test_an_exported_csv_is_a_plain_recording(recording, tmp_path):
    out = tmp_path / "line_x_1.csv"
    result = CliRunner().invoke(command, [str(recording), "--out", str(out), "--json"], standalone_mode=False)
    assert result.return_value == 0
    reported = json.loads(result.stdout)
    assert (reported["rows"], reported["cycles"], reported["problems"]) == (CYCLES, CYCLES, [])
    plain, direct = read_plain(out), to_recording(recording)
    assert plain.motion == direct.motion == "line_x"
    np.testing.assert_allclose(plain.wheel_angle_rad, direct.wheel_angle_rad)
    np.testing.assert_allclose(plain.truth_pose, direct.truth_pose, atol=1e-12)


def test_a_damaged_recording_is_exported_as_far_as_it_goes(recording, tmp_path):
    cut = tmp_path / "cut.mcap"
    data = recording.read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    result = CliRunner().invoke(command, [str(cut), "--json"], standalone_mode=False)
    assert result.return_value == 2
    reported = json.loads(result.stdout)
    assert 0 < reported["rows"] < CYCLES
    assert "ends early" in reported["problems"][0]
    assert "ends early" in result.stderr
    assert (tmp_path / "cut.csv").exists()


MAPPING = f"""
schema = 2
[wheels]
topic = "/joint_states"
drive = {json.dumps(SERVOS[:4])}
steer = {json.dumps(SERVOS[4:])}
[truth]
topic = "/mocap/pose"
"""


def mapped(tmp_path, text):
    path = tmp_path / "topics.toml"
    path.write_text(text, encoding="utf-8")
    return read_topic_map(path)


def test_a_bag_read_by_topics_gives_the_recorded_wheels(recording, tmp_path):
    # Our own file is a rosbag2 recording too: its ROS topics must tell the same as its cycle records.
    bag, ours = read_bag(recording, mapped(tmp_path, MAPPING)), to_recording(recording)
    np.testing.assert_array_equal(bag.wheel_angle_rad, ours.wheel_angle_rad)
    np.testing.assert_array_equal(bag.steering_rad, ours.steering_rad)
    np.testing.assert_array_equal(bag.wheel_rate_rad_s[:, 0], 1.0)
    sampled = [driving_record(k).inputs.mocap[0].position_m[:2] for k in range(CYCLES)]
    np.testing.assert_array_equal(bag.truth_pose[:, :2], sampled)


def test_signs_and_zeros_of_the_mapping_are_applied(recording, tmp_path):
    extra = "drive_sign = [1, 1, -1, -1]\nsteer_zero_rad = [0.1, 0.0, 0.0, 0.0]\n[truth]"
    plain = read_bag(recording, mapped(tmp_path, MAPPING))
    other = read_bag(recording, mapped(tmp_path, MAPPING.replace("[truth]", extra)))
    np.testing.assert_array_equal(other.wheel_angle_rad, plain.wheel_angle_rad * [1, 1, -1, -1])
    np.testing.assert_allclose(other.steering_rad, plain.steering_rad - [0.1, 0, 0, 0])


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("/joint_states", "/wheels", "has no topic /wheels"),
        ("drive_BL", "left", "has no joint left"),
        ("/mocap/pose", "/imu/data", "another type"),
    ],
)
def test_a_mapping_that_does_not_fit_names_what_is_there(recording, tmp_path, old, new, reason):
    topics = mapped(tmp_path, MAPPING.replace(old, new))
    with pytest.raises(DataError, match=reason) as caught:
        read_bag(recording, topics)
    assert caught.value.path == str(recording)


@pytest.mark.parametrize(("name", "way"), [("x.tum", "--trajectories"), ("x.json", "")])
def test_an_ending_that_is_no_table_names_those_that_are(recording, tmp_path, name, way):
    words = [str(recording), "--out", str(tmp_path / name)]
    refused = CliRunner().invoke(command, words, standalone_mode=False).exception
    assert isinstance(refused, UsageError)
    for ending in (".csv", ".parquet", way):
        assert ending in str(refused)
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_nothing_but_an_earlier_export_is_written_over(recording, tmp_path, kind):
    out = tmp_path / f"table.{kind}"
    words = [str(recording), "--out", str(out)]
    if kind == "csv":
        out.write_bytes(b"t,x,y,theta\n0,0,0,0\n")
    else:
        pyarrow.parquet.write_table(pyarrow.table({"t": [0.0]}), str(out))
    before = out.read_bytes()
    refused = CliRunner().invoke(command, words, standalone_mode=False)
    assert isinstance(refused.exception, UsageError)
    assert f"{out}: exists already and is no export of a recording" in str(refused.exception)
    assert out.read_bytes() == before
    out.unlink()
    for _ in range(2):
        assert CliRunner().invoke(command, words, standalone_mode=False).exception is None


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_disk_that_is_full_costs_no_earlier_export(recording, tmp_path, monkeypatch, kind):
    """The earlier file had been cut, or was gone."""
    path = tmp_path / f"e.{kind}"
    write_table(wheel_table(map(driving_record, range(20))), path, kind)
    whole, lines = path.read_bytes(), itertools.count()

    def full(value):
        if next(lines) == 500:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return value != value

    if kind == "csv":
        monkeypatch.setattr("hil.datasets.export.math.isnan", full)
    else:
        monkeypatch.setattr(pyarrow.parquet, "write_table", lambda table, file: [full(k) for k in range(501)])
    with pytest.raises(DataError, match=rf"e\.{kind}: cannot be written \(No space left on device\)"):
        write_table(wheel_table(map(driving_record, range(40))), path, kind)
    assert path.read_bytes() == whole
    assert list(tmp_path.iterdir()) == [path]
