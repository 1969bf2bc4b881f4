"""A matrix of programs: each reads what the bench writes, and what each writes is read here.

They are not installed with the tests: HIL_OTHER_PROGRAMS names a Python that has them, or is `install`, for a
new environment with the versions in `VERSIONS`.
"""

import csv
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import perfect_robot as perfect
import pytest
import test_trajectory_exchange as exchange
from mcap_cases import driving_record
from recorded import HEADER, messages
from test_rewritten_files import told

from hil.datasets.export import wheel_table, write_table
from hil.datasets.plain_csv import read_plain
from hil.datasets.rosbag import read_bag
from hil.datasets.trajectory_files import write_trajectories
from hil.recording.mcap_reader import read_cycles
from hil.recording.mcap_writer import McapRecorder

GIVEN = os.environ.get("HIL_OTHER_PROGRAMS", "")
VERSIONS = (
    "pymcap-cli==0.34.0",
    "foxglove-sdk==0.30.3",
    "rerun-sdk==0.41.0",
    "evo==1.38.1",
    "pandas==3.1.1",
    "polars==2.1.0",
    "pyarrow==26.0.1",
    "rosbags==0.11.9",
)
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not GIVEN, reason="HIL_OTHER_PROGRAMS names no Python with the other programs"),
]
CYCLES = 120


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """Runs a program of the other environment; returns what it printed."""
    home = tmp_path_factory.mktemp("home")
    python = Path(GIVEN)
    if GIVEN == "install":
        subprocess.run([sys.executable, "-m", "venv", home / "venv"], check=True)
        python = home / "venv" / "bin" / "python"
        subprocess.run([python, "-m", "pip", "install", "--quiet", *VERSIONS], check=True, timeout=1200)

    def run(program, *arguments):
        command = [python if program == "python" else python.parent / program, *arguments]
        environment = {**os.environ, "HOME": str(home), "MPLBACKEND": "agg"}
        done = subprocess.run(
            list(map(str, command)), capture_output=True, text=True, timeout=300, env=environment, check=False
        )
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
        return done.stdout

    return run


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    path = tmp_path_factory.mktemp("ours") / "run.mcap"
    recorder = McapRecorder(path, HEADER, lossless=True)
    for k in range(CYCLES):
        record = driving_record(k)
        if k in (0, 60):
            recorder.note(record.start_ns, "mark", {"before": k})
        recorder.write(record)
    recorder.close()
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """A rosbag2 folder of another robot, its mapping, and what is read of it."""
    return perfect.bag_as_read(tmp_path_factory.mktemp("bag"))


REWRITES = {
    "sort": lambda a, b: ("sort", a, "-o", b),
    "sort by topic": lambda a, b: ("sort", "--order", "topic", a, "-o", b),
    "sort without chunks": lambda a, b: ("sort", "--no-chunks", a, "-o", b),
    "rechunk": lambda a, b: ("rechunk", a, b, "--strategy", "all"),
    "filter": lambda a, b: ("filter", a, "-o", b),
    "process": lambda a, b: ("process", a, "-o", b),
    "recover": lambda a, b: ("recover", a, "-o", b),
    "lz4": lambda a, b: ("compress", a, "-o", b, "--compression", "lz4"),
    "plain": lambda a, b: ("decompress", a, "-o", b),
}


@pytest.mark.parametrize("how", REWRITES)
def test_pymcap_cli_rewrites_ours_and_a_bag(other, ours, bag, tmp_path, how):
    other("pymcap-cli", *REWRITES[how](ours, tmp_path / "run.mcap"))
    assert told(tmp_path / "run.mcap") == told(ours)
    made, mapping, expected = bag
    (file,) = made.glob("*.mcap")
    other("pymcap-cli", *REWRITES[how](file, tmp_path / "curve_1.mcap"))
    np.testing.assert_array_equal(read_bag(tmp_path / "curve_1.mcap", mapping).t_s, expected.t_s)


def test_pymcap_cli_finds_nothing_wrong_with_ours(other, ours):
    assert json.loads(other("pymcap-cli", "info-json", ours))["statistics"]["message_count"] > 10 * CYCLES
    other("pymcap-cli", "doctor", ours)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_rosbags_converts_a_bag(other, bag, tmp_path, storage):
    made, mapping, expected = bag
    (file,) = made.glob("*.mcap")
    anew = tmp_path / "curve_1"
    other("rosbags-convert", "--src", file, "--dst", anew, "--dst-storage", storage)
    np.testing.assert_array_equal(read_bag(anew, mapping).t_s, expected.t_s)


FOXGLOVE = """
import base64, json, sys
import foxglove
from foxglove import Channel, Schema

given = json.load(open(sys.argv[1]))
channels = {}
with foxglove.open_mcap(sys.argv[2]):
    for topic, kind, definition, t_ns, data in given:
        if topic not in channels:
            schema = Schema(name=kind, encoding="ros2msg", data=definition.encode())
            channels[topic] = Channel(topic, schema=schema, message_encoding="cdr")
        channels[topic].log(base64.b64decode(data), log_time=t_ns)
"""


def test_foxglove_sdk_writes_a_bag(other, bag, tmp_path):
    """Its files have no profile."""
    import base64

    _, mapping, expected = bag
    given = []
    for topic, t_s, message in perfect.messages(perfect.drive()):
        kind = perfect.JOINT if topic == "/wheels" else perfect.POSE
        definition = perfect.STORE.generate_msgdef(kind, ros_version=2)[0]
        data = base64.b64encode(bytes(perfect.STORE.serialize_cdr(message, kind))).decode()
        given.append((topic, kind, definition, perfect.BEGIN_NS + round(t_s * 1e9), data))
    (tmp_path / "given.json").write_text(json.dumps(given))
    (tmp_path / "write.py").write_text(FOXGLOVE)
    other("python", tmp_path / "write.py", tmp_path / "given.json", tmp_path / "curve_1.mcap")
    np.testing.assert_array_equal(read_bag(tmp_path / "curve_1.mcap", mapping).t_s, expected.t_s)


def test_rerun_reads_ours(other, ours, tmp_path):
    other("rerun", "mcap", "convert", ours, "-o", tmp_path / "run.rrd")
    said = other("rerun", "rrd", "stats", tmp_path / "run.rrd")
    assert "num_rows" in said or "rows" in said.lower()


def test_evo_reads_our_estimate_and_ground_truth(other, ours, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    other("evo_traj", "mcap", ours, "/odom", "/mocap/pose", "--save_as_tum")
    expected = {"odom": [], "mocap_pose": []}
    for topic, _, message in messages(ours):
        if topic in ("/odom", "/mocap/pose"):
            pose = message.pose.pose if topic == "/odom" else message.pose
            expected[topic.strip("/").replace("/", "_")].append((pose.position.x, pose.position.y))
    for name, poses in expected.items():
        (file,) = tmp_path.glob(f"*{name}*.tum")
        np.testing.assert_allclose(np.loadtxt(file)[:, 1:3], poses, atol=1e-6)


EVO = """
import copy, json, sys
from evo.core import metrics
from evo.tools.file_interface import read_kitti_poses_file, read_tum_trajectory_file

folder, path = sys.argv[1], metrics.PoseRelation.translation_part
turn = metrics.PoseRelation.rotation_angle_rad
for read, kind in ((read_tum_trajectory_file, "tum"), (read_kitti_poses_file, "kitti")):
    truth, own = (read(f"{folder}/{name}.{kind}") for name in ("truth", "estimate"))
    found = {}
    for how in ("none", "origin", "se2"):
        moved = copy.deepcopy(own)
        if how != "none":
            {"origin": moved.align_origin, "se2": moved.align}[how](truth)
        figures = [metrics.APE(path), metrics.APE(turn)]
        over = dict(delta=0.1, delta_unit=metrics.Unit.meters, pairs_from_reference=True)
        figures += [metrics.RPE(path, **over), metrics.RPE(turn, **over)]
        for one in figures:
            one.process_data((truth, moved))
        found[how] = [one.get_statistic(metrics.StatisticsType.rmse) for one in figures]
    print(json.dumps(found))
"""


def test_evo_finds_the_figures_that_are_kept(other, tmp_path):
    """From TUM and from KITTI files; the figures that the tests of the bench compare with."""
    truth, estimate = exchange.figures()
    write_trajectories(tmp_path, exchange.T_S, {"truth": truth, "estimate": estimate})
    (tmp_path / "evo_figures.py").write_text(EVO)
    for line in other("python", tmp_path / "evo_figures.py", tmp_path).splitlines():
        for how, figures in json.loads(line).items():
            assert figures == pytest.approx(exchange.EVO_1_38_1[how], rel=1e-5)


TABLES = """
import json, sys
import pandas, polars

folder = sys.argv[1]
print(json.dumps({
    "pandas csv": pandas.read_csv(f"{folder}/run.csv").isna().sum().to_dict(),
    "pandas parquet": pandas.read_parquet(f"{folder}/run.parquet").isna().sum().to_dict(),
    "polars csv": polars.read_csv(f"{folder}/run.csv", infer_schema_length=None).null_count().to_dicts()[0],
    "polars parquet": polars.read_parquet(f"{folder}/run.parquet").null_count().to_dicts()[0],
}, default=int))
pandas.read_csv(f"{folder}/drive_1.csv").to_csv(f"{folder}/pandas_1.csv", index=False)
polars.read_csv(f"{folder}/drive_1.csv", infer_schema_length=None).write_csv(f"{folder}/polars_1.csv")
"""


def test_pandas_and_polars_read_our_tables_and_write_them_again(other, ours, tmp_path):
    """Polars counted no missing value in a Parquet file: there NaN is a number."""
    records = [
        replace(each, measurements=replace(each.measurements, mocap=())) if 40 <= each.cycle < 90 else each
        for each in read_cycles(ours)
    ]
    write_table(wheel_table(records), tmp_path / "run.csv", "csv")
    write_table(wheel_table(records), tmp_path / "run.parquet", "parquet")
    perfect.write_csv(tmp_path / "drive_1.csv", perfect.drive())
    (tmp_path / "tables.py").write_text(TABLES)
    found = json.loads(other("python", tmp_path / "tables.py", tmp_path).splitlines()[-1])
    with (tmp_path / "run.csv").open() as file:
        rows = list(csv.DictReader(file))
    empty = {name: sum(row[name] == "" for row in rows) for name in rows[0]}
    assert sum(empty.values()) > 0
    for program, counts in found.items():
        assert {name: int(count) for name, count in counts.items()} == empty, program
    expected = read_plain(tmp_path / "drive_1.csv")
    for name in ("pandas_1", "polars_1"):
        again = read_plain(tmp_path / f"{name}.csv")
        np.testing.assert_array_equal(again.wheel_angle_rad, expected.wheel_angle_rad)
        np.testing.assert_array_equal(again.truth_pose, expected.truth_pose)
