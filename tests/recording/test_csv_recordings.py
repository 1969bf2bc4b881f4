"""Reading CSV recordings: round trips, repairs that are counted, refusals that name the file."""

import gzip

import numpy as np
import pytest

from hil.calibration.synthetic import hidden_robot, simulate
from hil.core.errors import DataError
from hil.datasets import number_table
from hil.datasets.cleaning import NO_HEADING, Log, increasing
from hil.datasets.plain_csv import read_plain, write_plain
from hil.datasets.public_csv import read_pair
from hil.datasets.read import read_recordings
from hil.datasets.wheel_log import build_recording
from hil.support.extras import is_installed

needs_pyarrow = pytest.mark.skipif(not is_installed("parquet"), reason="the extra parquet is not installed")
NAMES = [f"{w}_{k}" for w in ("BL", "BR", "FL", "FR") for k in ("Position", "Wheel")]


@pytest.fixture(scope="module")
def run():
    return simulate(hidden_robot(1), "line_x", "line_x_1", np.random.default_rng(1))


def logs(n=200):
    t = np.arange(n) * 0.02
    wheels = np.column_stack([np.outer(t, np.full(4, 1.97)), np.zeros((n, 4))])
    truth = np.column_stack([0.05 * t, np.zeros(n), np.zeros(n)])
    return t, wheels, truth


def write_pair(folder, n=200, *, columns=True, compress=False, break_rows=()):
    t, wheels, truth = logs(n)
    order = {f"{w}_Wheel": i for i, w in enumerate(("FL", "BL", "BR", "FR"))}
    odom = [
        "time;.header.seq;.header.stamp.secs;.header.stamp.nsecs;.header.frame_id;.name;.position;.velocity;.effort"
    ]
    absolute = [
        "time;.header.seq;.header.stamp.secs;.header.stamp.nsecs;.header.frame_id;.pose.position.x;"
        ".pose.position.y;.pose.position.z;.pose.orientation.x;.pose.orientation.y;.pose.orientation.z;.pose.orientation.w"
    ]
    for k in range(n):
        stamp = f"2024/05/03/12:00:{t[k]:09.6f};{k};{1000 + int(t[k])};{round((t[k] % 1) * 1e9)}"
        position = [float(wheels[k, order[m]]) + order[m] if m in order else 0.01 for m in NAMES]
        rate = [1.97 + 0.1 * order[m] if m in order else 0.0 for m in NAMES]
        row = f"{stamp};;{NAMES};{tuple(position)};{tuple(rate)};{(0.0,) * 8}"
        odom.append("garbage" if k in break_rows else row)
        absolute.append(f"{stamp};world;{truth[k, 0]};{truth[k, 1]};0;0;0;0;1")
    if not columns:
        odom = [line.replace(".position", ".place") for line in odom]
    for name, lines in (("odom_3.csv", odom), ("abs_3.csv", absolute)):
        data = ("\n".join(lines) + "\n").encode()
        (folder / (name + ".gz" * compress)).write_bytes(gzip.compress(data) if compress else data)


def test_plain_csv_reads_back_what_was_written(tmp_path, run):
    write_plain(tmp_path / "line_x_1.csv", run)
    back = read_plain(tmp_path / "line_x_1.csv")
    assert (back.name, back.motion) == ("line_x_1", "line_x")
    np.testing.assert_allclose(back.wheel_angle_rad, run.wheel_angle_rad, atol=1e-6)
    np.testing.assert_allclose(back.steering_rad, run.steering_rad, atol=1e-6)
    np.testing.assert_allclose(back.wheel_rate_rad_s, run.wheel_rate_rad_s, atol=1e-6)
    truth = np.interp(run.t_s, run.truth_t_s, run.truth_pose[:, 0])
    np.testing.assert_allclose(back.truth_pose[:, 0], truth, atol=1e-6)


@pytest.mark.parametrize("compress", [False, True])
def test_public_pairs_come_in_paper_wheel_order(tmp_path, compress):
    write_pair(tmp_path, compress=compress)
    (recording,) = read_recordings([tmp_path])
    assert recording.motion == "line_x"
    np.testing.assert_allclose(recording.wheel_angle_rad[0], [0, 1, 2, 3], atol=1e-9)
    np.testing.assert_allclose(recording.wheel_rate_rad_s[0], [1.97, 2.07, 2.17, 2.27])
    np.testing.assert_allclose(np.diff(recording.t_s), 0.02, atol=1e-9)
    assert len(recording.sha256) == 2


def test_both_files_of_a_public_pair_are_one_recording(tmp_path):
    """As a shell gives them: `odom_*.csv abs_*.csv`."""
    write_pair(tmp_path)
    odom, absolute = tmp_path / "odom_3.csv", tmp_path / "abs_3.csv"
    (one,) = read_recordings([odom, absolute])
    assert one.repairs == {}
    (again,) = read_recordings([tmp_path, absolute])
    assert again.repairs == {f"mentions of {odom} beyond the first left out": 1}


def test_a_folder_of_pairs_and_other_recordings_gives_all_of_them(tmp_path, run):
    write_pair(tmp_path)
    write_plain(tmp_path / "line_y_1.csv", run)
    assert [one.name for one in read_recordings([tmp_path])] == ["odom_3", "line_y_1"]
    (tmp_path / "abs_7.csv").write_bytes((tmp_path / "abs_3.csv").read_bytes())
    with pytest.raises(DataError, match=r"abs_7\.csv: has no odometry file; expected odom_7\.csv"):
        read_recordings([tmp_path])


def test_a_bag_of_another_robot_beside_recordings_is_not_passed_over(tmp_path, run):
    write_plain(tmp_path / "line_y_1.csv", run)
    (tmp_path / "foreign.db3").touch()
    with pytest.raises(DataError, match=r"rosbag2 recordings of another robot \(foreign\.db3\).*--topics"):
        read_recordings([tmp_path])


def test_a_column_that_is_there_twice_is_named(tmp_path, run):
    path = tmp_path / "line_x_1.csv"
    write_plain(path, run)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0] + ",x,note,note", *(line + ",9,1,1" for line in lines[1:])]))
    with pytest.raises(DataError, match=r"line_x_1\.csv: has the columns x more than once"):
        read_plain(path)
    path.write_text(path.read_text().replace(",x,note", ",other,note", 1))
    assert len(read_plain(path).t_s) == len(run.t_s)


@pytest.mark.parametrize("fast", [pytest.param(True, marks=needs_pyarrow), False])
def test_quick_and_slow_path_agree_and_broken_rows_are_counted(tmp_path, fast, monkeypatch):
    monkeypatch.setattr(number_table, "is_installed", lambda extra: fast)
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    write_pair(tmp_path / "a")
    write_pair(tmp_path / "b", break_rows=(50,))
    (whole,), (broken,) = read_recordings([tmp_path / "a"]), read_recordings([tmp_path / "b"])
    assert broken.repairs["wheel rows without numbers dropped"] == 1
    np.testing.assert_array_equal(np.delete(whole.wheel_angle_rad, 50, axis=0), broken.wheel_angle_rad)


@pytest.mark.parametrize("fast", [pytest.param(True, marks=needs_pyarrow), False])
def test_a_number_that_slid_into_the_next_row_is_no_even_table(tmp_path, fast, monkeypatch):
    """As many numbers as in a whole file, but one row has one too few and the next one too many."""
    monkeypatch.setattr(number_table, "is_installed", lambda extra: fast)
    write_pair(tmp_path)
    lines = (tmp_path / "abs_3.csv").read_text().splitlines()
    lines[20], lines[21] = lines[20].removesuffix(";1"), lines[21] + ";1"
    (tmp_path / "abs_3.csv").write_text("\n".join(lines) + "\n")
    (recording,) = read_recordings([tmp_path])
    assert recording.repairs == {"ground-truth rows without numbers dropped": 2}


@needs_pyarrow
def test_plain_files_are_read_alike_at_once_and_line_by_line(tmp_path, run, monkeypatch):
    """A gap in the ground truth is `nan` in some rows."""
    gap = (run.truth_t_s > 1.0) & (run.truth_t_s < 1.5)
    truth = Log(run.truth_t_s[~gap], run.truth_pose[~gap])
    wheels = Log(run.t_s, np.column_stack([run.wheel_angle_rad, run.steering_rad]))
    path = tmp_path / "line_x_1.csv"
    write_plain(path, build_recording("line_x_1", wheels, truth))
    assert b"nan" in path.read_bytes()
    found = []
    for at_once in (number_table._by_pyarrow, number_table._by_numpy, lambda *_: None):
        monkeypatch.setattr(number_table, "_by_pyarrow", at_once)
        read = read_plain(path)
        found.append((read.t_s, read.wheel_angle_rad, read.steering_rad, read.truth_t_s, read.truth_pose))
    for other in found[1:]:
        for one, same in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(one, same)


@pytest.mark.parametrize("cell", ["1_0", "\u0e51", "true"])
def test_what_is_hardly_a_number_is_named(tmp_path, run, cell):
    path = tmp_path / "line_x_1.csv"
    write_plain(path, run)
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[100] = ",".join([lines[100].split(",")[0], cell, *lines[100].split(",")[2:]])
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(DataError, match=f"line 101 holds text in the column phi1: '{cell}'"):
        read_plain(path)


def test_each_repair_is_counted():
    t, wheels, truth = logs()
    t_wheels = t.copy()
    t_wheels[[50, 51]] = t_wheels[[51, 50]]
    t_wheels[80] = t_wheels[79]
    t_wheels[100:] += 0.5
    wheels = wheels.copy()
    wheels[20, 2] = np.nan
    wheels[150:, 1] -= 2 * np.pi * 256
    truth[30] = np.nan
    recording = build_recording("run", Log(t_wheels, wheels), Log(t, truth))
    assert recording.repairs == {
        "wheel rows without numbers dropped": 1,
        "wheel stamps out of order sorted": 1,
        "wheel rows with a repeated stamp dropped": 1,
        "wheel gaps over 0.1 s bridged": 1,
        "wheel-angle wrap-arounds undone": 1,
        "ground-truth rows without numbers dropped": 1,
    }
    assert np.all(np.diff(recording.t_s) > 0)
    assert np.max(np.abs(np.diff(recording.wheel_angle_rad, axis=0))) < 1.1
    assert len(recording.warnings()) == 6


@pytest.mark.parametrize("stamp_s", [-5.0, 1000.0, 3.301])
def test_a_row_with_a_stamp_far_from_those_beside_it_is_dropped_and_named(stamp_s):
    """It would be the start, the end, or a wheel that leaps."""
    t, wheels, truth = logs()
    spoilt = t.copy()
    spoilt[50] = stamp_s
    recording = build_recording("run", Log(spoilt, wheels), Log(spoilt, truth))
    assert len(recording.t_s) == len(recording.truth_t_s) == len(t) - 1
    np.testing.assert_array_equal(recording.t_s, np.delete(t, 50))
    (by_truth, by_wheels) = sorted(recording.repairs)
    assert (
        by_wheels == "wheel rows stamped far from the rows beside them dropped (first 0.98 s after its begin)"
    )
    assert by_truth.startswith("ground-truth rows stamped far")


def test_a_row_that_comes_late_is_sorted_where_it_is_missing():
    t, wheels, truth = logs()
    order = np.insert(np.delete(np.arange(len(t)), 20), 150, 20)
    recording = build_recording("run", Log(t[order], wheels[order]), Log(t, truth))
    np.testing.assert_array_equal(recording.t_s, t)
    assert recording.repairs == {"wheel stamps out of order sorted": 1}


def test_rows_that_vanish_behind_one_stamp_are_refused(tmp_path):
    """Nanoseconds that hold milliseconds, or whole seconds: a hundredth of the rows would be left."""
    t, wheels, truth = logs(2000)
    with pytest.raises(DataError, match=r"^run: 19\d\d of 2000 wheel rows have the stamp of another row"):
        build_recording("run", Log(np.floor(t), wheels), Log(t, truth))
    twice = np.repeat(np.arange(len(t)), 5)
    assert len(build_recording("run", Log(t[twice], wheels[twice]), Log(t, truth)).t_s) == len(t)


def test_wrapped_heading_is_unwrapped():
    t, wheels, truth = logs()
    truth[:, 2] = np.angle(np.exp(1j * 3.0 * t))
    recording = build_recording("run", Log(t, wheels), Log(t, truth))
    assert recording.truth_pose[-1, 2] == pytest.approx(3.0 * t[-1])


def test_receive_stamps_become_increasing_by_microseconds():
    out = increasing(np.array([0.0, 1.0, 1.0, 0.9, 2.0]))
    np.testing.assert_allclose(out, [0.0, 1.0, 1.000001, 1.000002, 2.0], atol=1e-9)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda w, t: (w, 1000 * t), "millimetres"),
        (
            lambda w, t: (
                np.column_stack([w[:, :4], np.full((len(w), 4), 45.0)]),
                np.sqrt(0.5) * t[:, [0, 0, 2]],
            ),
            "degrees",
        ),
        (lambda w, t: (w, np.full_like(t, np.nan)), "ground truth"),
        (lambda w, t: (w * np.nan, t), "usable wheel rows"),
    ],
)
def test_what_cannot_be_right_is_refused_with_a_remedy(spoil, message):
    t, wheels, truth = logs()
    wheels, truth = spoil(wheels, truth)
    with pytest.raises(DataError, match=message):
        build_recording("run", Log(t, wheels), Log(t, truth))


def test_logs_that_do_not_overlap_are_refused():
    t, wheels, truth = logs()
    with pytest.raises(DataError, match="share"):
        build_recording("run", Log(t, wheels), Log(t + 100, truth))


def test_bad_files_are_named(tmp_path):
    empty = tmp_path / "line_x_1.csv"
    empty.write_text("")
    with pytest.raises(DataError, match=r"line_x_1\.csv: is empty"):
        read_recordings([empty])
    empty.write_text("t,phi1\n0,1\n")
    with pytest.raises(DataError, match="lacks the columns phi2"):
        read_recordings([empty])
    with pytest.raises(DataError, match="does not exist"):
        read_recordings([tmp_path / "nowhere"])
    (tmp_path / "void").mkdir()
    with pytest.raises(DataError, match=r"holds no recording; expected [^;]+$"):
        read_recordings([tmp_path / "void"])
    (tmp_path / "void" / "inner").mkdir()
    (tmp_path / "void" / "inner" / "line_x_1.csv").write_text("")
    with pytest.raises(DataError, match=r"name the folder that does: .*/void/inner$"):
        read_recordings([tmp_path / "void"])


def spoilt_header(tmp_path, run, spoil):
    path = tmp_path / "line_x_1.csv"
    write_plain(path, run)
    header, _, rows = path.read_bytes().partition(b"\r\n")
    path.write_bytes(spoil(header) + b"\r\n" + rows)
    return path


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (
            lambda line: line.replace(b"phi1", b"PHI1"),
            r"lacks the columns phi1 \(it has PHI1 in place of phi1\)",
        ),
        (lambda line: b"# my data\r\n" + line, r"first line holds no names of columns: '# my data.*delete"),
        (lambda line: b"# L\xe4nge\r\n" + line, "first line is not UTF-8 text: '# Länge.*save it as UTF-8"),
        (lambda line: line.replace(b"theta", b"th\xeata"), "first line is not UTF-8 text: .*thêta"),
        (lambda line: b"0,1,2,3", r"first line holds no names of columns: '0,1,2,3"),
    ],
)
def test_what_the_first_line_holds_in_place_of_the_names_is_said(tmp_path, run, spoil, said):
    with pytest.raises(DataError, match=r"line_x_1\.csv: .*" + said):
        read_plain(spoilt_header(tmp_path, run, spoil))


def test_names_in_quotes_and_foreign_columns_in_other_text_are_read(tmp_path, run):
    """As R writes them."""
    quoted = spoilt_header(tmp_path, run, lambda line: b'"' + line.replace(b",", b'","') + b'"')
    assert len(read_plain(quoted).t_s) == len(run.t_s)
    lines = quoted.read_bytes().splitlines()
    quoted.write_bytes(b"\n".join([lines[0] + b",L\xe4nge", *(line + b",1" for line in lines[1:])]))
    assert len(read_plain(quoted).t_s) == len(run.t_s)


def test_columns_that_are_not_read_are_named_where_wheel_angles_are_missing(tmp_path, run):
    (what,) = (
        what
        for what in read_plain(
            spoilt_header(tmp_path, run, lambda line: line.replace(b"phi", b"wheel"))
        ).repairs
        if "missing" in what
    )
    assert "phi1, phi2, phi3, phi4" in what
    assert "wheel1, wheel2, wheel3, wheel4" in what


def test_damaged_public_files_are_named(tmp_path):
    write_pair(tmp_path, compress=True)
    odom, absolute = tmp_path / "odom_3.csv.gz", tmp_path / "abs_3.csv.gz"
    whole = odom.read_bytes()
    odom.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(DataError, match=r"odom_3\.csv\.gz: damaged gzip"):
        read_recordings([tmp_path])
    odom.write_bytes(whole)
    absolute.unlink()
    with pytest.raises(DataError, match="no ground truth"):
        read_recordings([tmp_path])
    (tmp_path / "c").mkdir()
    write_pair(tmp_path / "c", columns=False)
    with pytest.raises(DataError, match="lacks the columns"):
        read_recordings([tmp_path / "c"])


@pytest.mark.parametrize("quaternion", ["0;0;0;0", "0;0;0;2"])
def test_public_pairs_without_a_heading_are_refused_and_single_rows_left_out(tmp_path, quaternion):
    write_pair(tmp_path)
    absolute = tmp_path / "abs_3.csv"
    lines = absolute.read_text().splitlines()
    spoilt = [line.removesuffix("0;0;0;1") + quaternion for line in lines]
    absolute.write_text("\n".join([*lines[:50], *spoilt[50:60], *lines[60:]]) + "\n")
    (found,) = read_recordings([tmp_path])
    assert found.repairs[NO_HEADING] == 10
    assert len(found.truth_t_s) == 190
    absolute.write_text("\n".join([lines[0], *spoilt[1:]]) + "\n")
    with pytest.raises(DataError, match=r"abs_3\.csv: none of 200 rows holds a heading"):
        read_recordings([tmp_path])


def test_the_public_recordings_are_classified_and_read_whole(public_data):
    odom = sorted(public_data.glob("odom_*.csv.gz"))[0]
    recording = read_pair(odom, public_data / odom.name.replace("odom", "abs"))
    assert recording.has_rates
    assert np.median(np.diff(recording.t_s)) == pytest.approx(0.016, abs=5e-4)
    recordings = read_recordings([public_data])
    assert len(recordings) == 24
    assert all(np.all(np.isfinite(r.truth_pose)) for r in recordings)
    assert not [what for r in recordings for what in r.repairs if "copy" in what]
    by_run = {int(r.name.split("_")[1]): r.motion for r in recordings}
    motions = ("line_x", "line_y", "circle_ccw", "circle_cw", "rotation_ccw", "rotation_cw")
    assert by_run == {run: motions[(run - 1) // 5] for run in by_run}


@pytest.mark.parametrize(("name", "column"), [("abs_3.csv", 3), ("odom_3.csv", 3)])
def test_parts_of_a_second_in_microseconds_are_named(tmp_path, name, column):
    write_pair(tmp_path)
    head, *rows = (tmp_path / name).read_text().splitlines()
    fields = [row.split(";") for row in rows]
    for one in fields:
        one[column] = str(int(one[column]) // 1000)
    (tmp_path / name).write_text("\n".join([head, *(";".join(one) for one in fields)]) + "\n")
    with pytest.raises(DataError, match=rf"{name}: the largest \.header\.stamp\.nsecs is \d+") as error:
        read_recordings([tmp_path])
    assert "multiply that column by 1000" in error.value.remedy
