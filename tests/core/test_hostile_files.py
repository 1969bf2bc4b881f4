"""Whatever is in a file, its reader gives a value or one of our errors that names it: never anything else.

`FOUND` keeps what once escaped; the rest is drawn by hypothesis from the structure of each format.
"""

import contextlib
import json
import math
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given
from hypothesis import strategies as st

from hil.calibration.calibration_file import read_calibration
from hil.cli import main
from hil.config.loading import load_bench
from hil.config.robot_record.folder import read_version
from hil.core.errors import DataError, HilError
from hil.core.result_names import JOURNAL
from hil.datasets.plain_csv import read_plain
from hil.datasets.public_csv import read_pair
from hil.datasets.topic_map import read_topic_map
from hil.drivers.imu.bno055.calibration import ImuCalibration
from hil.faults.files import read_faults
from hil.live.reference_files import read_waypoints
from hil.procedure.operator import Answers
from hil.procedure.parameters import split_settings
from hil.procedure.run_journal import read_journal
from hil.report.result_reader import read_result
from hil.report.run_page import write_run_page
from hil.support.file_reading import json_value, read_json, toml_tables
from tests.selected import draws

BOUNDED = draws(20, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
DEEP_TOML = "a = " + "[" * 100_000
DEEP_JSON = "[" * 100_000
TOMLS = {
    "bench": load_bench,
    "calibration": lambda path: read_calibration(Path(path)),
    "faults": lambda path: read_faults([str(path)]),
    "topics": read_topic_map,
    "imu": ImuCalibration.load,
    "record": lambda path: read_version(path, ""),
}
FOUND_TOML = (
    DEEP_TOML,
    "a = " + "{a = " * 100_000,
    ".".join("a" * 40_000) + " = 1",
    "[" + ".".join("a" * 40_000) + "]",
    "a = " + "1" * 5000,
    "schema = 1\nname = 'x'\nservos." + ".".join("a" * 60) + " = 1",
    'fault = [{device = "imu", kind = "stuck", at_s = 1e308}]',
    'fault = [{device = "imu", kind = "stuck", duration_s = inf}]',
    'fault = [{device = "imu", kind = "stuck", options = {at = 1, kind = 2}}]',
    'fault = [{device = "imu", kind = "stuck", options = {x = nan}}]',
    "accelerometer_offset = 1\nmagnetometer_offset = 1\ngyroscope_offset = 1\n"
    "accelerometer_radius = 1\nmagnetometer_radius = 1",
    "\x00",
    "\ufeffa = 1",
    "a = 1979-05-27",
    'schema = 1\nversion = 1\ncreated = 2026-11-22T12:00:00+00:00\nsha256 = "00"',
    'schema = 1\nversion = nan\nsha256 = "00"',
    "= 1",
    "a = '''",
)

WORDS = st.sampled_from(
    [
        "schema",
        "name",
        "fault",
        "device",
        "kind",
        "at_s",
        "options",
        "servos",
        "wheels",
        "truth",
        "topic",
        "drive",
        "parameters",
        "gyroscope_offset",
        "accelerometer_radius",
        "x",
        "version",
        "imu",
        "stuck",
    ]
)
SCALARS = st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats() | st.text(max_size=8) | WORDS
TREES = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(WORDS | st.text(max_size=4), inner, max_size=4)
    ),
    max_leaves=12,
)


def toml_of(tree):
    """A TOML value; JSON spells most of them the same."""
    if isinstance(tree, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {toml_of(v)}" for k, v in tree.items()) + "}"
    if isinstance(tree, list):
        return "[" + ", ".join(map(toml_of, tree)) + "]"
    if isinstance(tree, float) and not math.isfinite(tree):
        return "nan" if math.isnan(tree) else "inf"
    return '"none"' if tree is None else json.dumps(tree)


def refusal(reader, path):
    try:
        reader(path)
    except HilError as error:
        return error
    return None


def reads(reader, path, name=""):
    """Let a reader try; its error has to name the file."""
    error = refusal(reader, path)
    assert error is None or (error.exit_code == 2 and (name or path.name) in str(error))


@pytest.mark.parametrize("kind", TOMLS)
@pytest.mark.parametrize("text", FOUND_TOML, ids=range(len(FOUND_TOML)))
def test_toml_that_once_escaped(tmp_path, kind, text):
    path = tmp_path / "file.toml"
    path.write_text(text)
    reads(TOMLS[kind], path)


@pytest.mark.parametrize("kind", TOMLS)
@BOUNDED
@given(tree=st.dictionaries(WORDS | st.text(max_size=4), TREES, max_size=6))
def test_any_toml(tmp_path, kind, tree):
    path = tmp_path / "file.toml"
    path.write_text("".join(f"{json.dumps(k)} = {toml_of(v)}\n" for k, v in tree.items()))
    reads(TOMLS[kind], path)


@pytest.mark.parametrize("kind", ["faults", "record"])
@BOUNDED
@given(data=st.binary(max_size=60) | st.text("[]{}.=\"'\n a1#,", max_size=60).map(str.encode))
def test_any_bytes_as_toml(tmp_path, kind, data):
    path = tmp_path / "file.toml"
    path.write_bytes(data)
    reads(TOMLS[kind], path)


@pytest.mark.parametrize("text", [DEEP_TOML, FOUND_TOML[2]], ids=["deep", "long key"])
def test_the_command_line_ends_with_a_message(tmp_path, capsys, text):
    path = tmp_path / "my.toml"
    path.write_text(text)
    for arguments in (["run", "latency", "--bench", str(path)], ["doctor", "--bench", str(path)]):
        assert main(arguments) == 2
        assert "my.toml: not valid TOML" in capsys.readouterr().err


def test_a_key_may_have_parts_and_dots_may_stand_elsewhere():
    text = f'"a.b".c = "{"a." * 200}"\nd = [{"1.5, " * 200}]\n# {"x. " * 50}\n'
    assert toml_tables(text.replace("a." * 200, "a. " * 60), "x")["a.b"]["c"].startswith("a. a.")


def test_files_without_an_end_are_not_read_to_it(tmp_path, monkeypatch):
    path = tmp_path / "endless.json"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(DataError, match=r"endless\.json: cannot be read \(larger than 64 MiB\)"):
        read_json(path)


def result(**values):
    row = {"name": "a", "unit": "m", "value": 1.0, "low": 0.0, "high": 2.0, "outcome": "PASS"}
    return {"schema": 1, "procedure": "p", "verdict": "PASS", "measurements": [row]} | values


RESULT_KEYS = st.sampled_from(
    [
        "procedure",
        "verdict",
        "measurements",
        "error",
        "teardown_errors",
        "steps",
        "tables",
        "figures",
        "held",
        "attachments",
        "recordings",
        "notes",
        "parameters",
        "config",
        "calibration",
        "versions",
        "loop",
        "faults",
        "duration_s",
        "seed",
    ]
)
ROWS = st.dictionaries(
    st.sampled_from(["name", "unit", "value", "low", "high", "margin", "outcome", "limited", "rationale"]),
    SCALARS,
).map(lambda changes: result()["measurements"][0] | changes)


@BOUNDED
@given(changes=st.dictionaries(RESULT_KEYS, TREES, max_size=3), rows=st.lists(ROWS, max_size=2))
@example(changes={"seed": 10**400}, rows=[])
@example(changes={"calibration": {}}, rows=[result()["measurements"][0] | {"value": 10**400}])
@example(changes={}, rows=[result()["measurements"][0] | {"value": 1e308, "low": -1e308, "high": 1e308}])
@example(changes={"notes": ["\ud800"], "procedure": "\ud800"}, rows=[])
@example(changes={"figures": [{"title": "t", "path": "\0"}]}, rows=[])
def test_any_result(tmp_path, changes, rows):
    (tmp_path / "result.json").write_text(json.dumps(result(measurements=rows) | changes))
    reads(write_run_page, tmp_path)


@pytest.mark.parametrize(
    "text", [DEEP_JSON, '{"a":' * 100_000, "1" * 5000, "NaN", "\x00", '{"schema": 1e400}']
)
def test_json_that_once_escaped(tmp_path, text):
    (tmp_path / "result.json").write_text(text)
    with pytest.raises(DataError, match=r"result\.json"):
        read_result(tmp_path)


@BOUNDED
@given(st.text(max_size=30) | st.text('[]{}",:1e-\\u', max_size=40) | st.binary(max_size=30))
def test_any_json_is_a_value_or_a_value_error(text):
    with contextlib.suppress(ValueError):
        json_value(text)


@pytest.mark.parametrize("value", [DEEP_JSON, "1" * 5000])
def test_any_setting_is_a_value_or_a_text(value):
    assert split_settings([f"bench.x={value}"])[1] == {"x": value}


ENTRIES = st.fixed_dictionaries(
    {
        "kind": st.sampled_from(
            [
                "run",
                "resume",
                "step",
                "checkpoint",
                "value",
                "measure",
                "attach",
                "table",
                "figure",
                "note",
                "recording",
                "end",
            ]
        )
        | SCALARS
    },
    optional={
        key: TREES
        for key in (
            "title",
            "value",
            "name",
            "path",
            "text",
            "verdict",
            "schema",
            "head",
            "rows",
            "note",
            "caption",
        )
    },
)


@BOUNDED
@given(entries=st.lists(ENTRIES, max_size=5))
@example(entries=[{"kind": "checkpoint", "title": []}])
@example(entries=[{"kind": "checkpoint", "title": "t"}, {"kind": "measure", "name": "n", "value": "x"}])
@example(entries=[{"kind": {}}])
def test_any_journal(tmp_path, entries):
    path = tmp_path / JOURNAL
    lines = [{"kind": "run", "schema": 1}, *entries]
    path.write_text("".join(json.dumps(entry) + "\n" for entry in lines))
    reads(read_journal, path)


HEADER = "t," + ",".join(f"phi{i}" for i in range(1, 5)) + "," + ",".join(f"delta{i}" for i in range(1, 5))
CELLS = st.floats().map(repr) | st.sampled_from(
    ["", "nan", "1e400", "-1e308", "x", '"', "1_0", "٣", "\x1c", "'"]
)
PLAIN_ROWS = st.lists(st.lists(CELLS, min_size=12, max_size=12).map(",".join), min_size=1, max_size=3).map(
    lambda rows: rows * 20
)


@BOUNDED
@given(rows=PLAIN_ROWS, end=st.sampled_from(["\n", "\r\n", "\r"]))
@example(rows=['"' + "1" * 200_000], end="\n")
@example(rows=["1,2\r3\r"], end="\n")
@example(rows=["\0" * 12], end="\n")
@example(rows=["0," * 11 + "1e400"] * 20, end="\n")
def test_any_plain_table(tmp_path, rows, end):
    path = tmp_path / "line_x_1.csv"
    path.write_bytes((HEADER + ",x,y,theta\n" + end.join(rows) + "\n").encode())
    reads(read_plain, path)


@BOUNDED
@given(rows=st.lists(st.lists(CELLS, min_size=3, max_size=3).map(",".join), max_size=4))
@example(rows=["1,2\r3"])
@example(rows=['"' + "1" * 200_000])
def test_any_waypoints(tmp_path, rows):
    path = tmp_path / "way.csv"
    path.write_bytes(("x,y,theta\n" + "\n".join(rows)).encode())
    reads(read_waypoints, path)


NAMES = str([f"{w}_{k}" for w in ("BL", "BR", "FL", "FR") for k in ("Position", "Wheel")])
ODOM = (
    "time;.header.seq;.header.stamp.secs;.header.stamp.nsecs;.header.frame_id;.name;.position;"
    ".velocity;.effort"
)
ABS = (
    "time;.header.seq;.header.stamp.secs;.header.stamp.nsecs;.header.frame_id;.pose.position.x;.pose.position.y;"
    ".pose.position.z;.pose.orientation.x;.pose.orientation.y;.pose.orientation.z;.pose.orientation.w"
)
NUMBERS = st.floats().map(repr) | st.sampled_from(
    ["1e", "1-2", "+", "e", "1.2.3", "", "nan", "--1", "1e400", "[", "("]
)


def pair(folder, odom_rows, abs_rows):
    (folder / "odom_1.csv").write_text("\n".join([ODOM, *odom_rows]) + "\n")
    (folder / "abs_1.csv").write_text("\n".join([ABS, *abs_rows]) + "\n")
    return folder / "odom_1.csv"


def public_rows(names, numbers, count=25):
    stamp = "2024/05/03/12:00:{k:02d}.5;1;1000;{number}"
    odom = stamp + ";;" + names + ";({number}, 0, 0, 0, 0, 0, 0, 0);(0, 0, 0, 0, 0, 0, 0, {number});(0,)*8"
    absolute = stamp + ";w;{number};0;0;0;0;0;{number}"
    values = [numbers[k % len(numbers)] for k in range(count)]
    return [
        [row.replace("(0,)*8", str((0.0,) * 8)).format(k=k, number=v) for k, v in enumerate(values)]
        for row in (odom, absolute)
    ]


@BOUNDED
@given(
    names=st.just(NAMES) | st.sampled_from(["1", "{}", "None", "('a')", "[" * 3000, "1+1j", "b'x'", ""]),
    numbers=st.lists(NUMBERS, min_size=1, max_size=3),
)
@example(names="1", numbers=["1"])
@example(names=NAMES, numbers=["1e"])
@example(names=NAMES, numbers=["1-2"])
@example(names=NAMES, numbers=["1e300"])
def test_any_public_pair(tmp_path, names, numbers):
    path = pair(tmp_path, *public_rows(names.replace("{", "{{").replace("}", "}}"), numbers))

    reads(lambda odom: read_pair(odom, odom.with_name("abs_1.csv")), path, "_1.csv")


@pytest.mark.parametrize("data", [b"\xff\xfe", b"\x00" * 10, b"a" * (2 << 20)])
def test_any_answers(tmp_path, data):
    path = tmp_path / "answers.txt"
    path.write_bytes(data)
    reads(Answers, path)
