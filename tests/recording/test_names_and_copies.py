"""Recordings of one name in several folders, and copies of a recording, as commands take them."""

import gzip
import hashlib
import json
import shutil
from dataclasses import replace

import perfect_robot as perfect
import pytest

from hil.calibration.calibrate import calibrate
from hil.calibration.calibration_file import read_calibration
from hil.calibration.problem import RECOMMENDED
from hil.calibration.synthetic import hidden_robot, make_set
from hil.cli import main
from hil.core.clock import MonotonicClock
from hil.core.errors import DataError
from hil.datasets.duplicates import is_copy
from hil.datasets.plain_csv import write_plain
from hil.datasets.read import read_recordings

MOTIONS = ("line_x", "line_y", "rotation_ccw")


@pytest.fixture(scope="module")
def drives():
    return make_set(hidden_robot(3), 3, MOTIONS, repetitions=2)


@pytest.fixture
def days(tmp_path, drives):
    """Two folders of one repetition each, whose files are called alike."""
    for one in drives:
        motion, _, number = one.name.rpartition("_")
        folder = tmp_path / "lab" / number
        folder.mkdir(parents=True, exist_ok=True)
        write_plain(folder / f"{motion}_1.csv", one)
    return tmp_path / "lab"


def hil(capsys, *words):
    capsys.readouterr()
    code = main([*map(str, words), "--json"])
    reported = capsys.readouterr()
    return code, json.loads(reported.out) if reported.out else {}, reported.err


def test_each_of_one_name_has_its_own_weight_and_digests(days, tmp_path, capsys):
    out = tmp_path / "c.toml"
    words = ["calibrate", days / "1", days / "2", "--model", "exact", "--no-validation", "--out", out]
    code, found, _ = hil(capsys, *words)
    names = [f"{day}/{motion}_1" for day in "12" for motion in sorted(MOTIONS)]
    assert (code, list(found["weights"])) == (0, names)
    kept = read_calibration(out).recordings
    assert list(kept) == names
    assert len({what["sha256"][0] for what in kept.values()}) == 6
    assert {name: what["weight"] for name, what in kept.items()} == found["weights"]


def test_as_few_folders_are_named_as_tell_apart(days, tmp_path, drives, monkeypatch):
    other = tmp_path / "shop" / "1"
    other.mkdir(parents=True)
    write_plain(other / "line_x_1.csv", drives[1])
    lab = days / "1"
    shutil.rmtree(days / "2")
    assert [r.name for r in read_recordings([lab, other])] == [
        "lab/1/line_x_1",
        "line_y_1",
        "rotation_ccw_1",
        "shop/1/line_x_1",
    ]
    monkeypatch.chdir(lab)
    assert read_recordings([".", other])[0].name == "lab/1/line_x_1"
    assert [r.name for r in read_recordings([other])] == ["line_x_1"]


def test_other_content_of_one_name_in_one_folder_goes_by_file_names(tmp_path, drives):
    write_plain(tmp_path / "line_x_1.csv", drives[0])
    write_plain(tmp_path / "b.csv", drives[1])
    (tmp_path / "line_x_1.csv.gz").write_bytes(gzip.compress((tmp_path / "b.csv").read_bytes()))
    (tmp_path / "b.csv").unlink()
    assert [r.name for r in read_recordings([tmp_path])] == ["line_x_1.csv", "line_x_1.csv.gz"]


def test_calibrate_refuses_recordings_of_one_name(drives):
    with pytest.raises(DataError, match="several recordings are called line_x_1; expected names that differ"):
        calibrate([drives[0], *drives], RECOMMENDED, MonotonicClock())


CHANGES = {
    "packed": gzip.compress,
    "a column": lambda data: data.replace(b"\r\n", b",0\n").replace(b",0\n", b",note\n", 1),
}


@pytest.mark.parametrize("change", CHANGES)
def test_copies_that_differ_in_form_are_left_out(tmp_path, drives, change):
    first, copy = tmp_path / "a", tmp_path / "b"
    first.mkdir()
    copy.mkdir()
    for one in drives[::2]:
        write_plain(first / f"{one.name}.csv", one)
        name = f"{one.motion}_2.csv" + (".gz" if change == "packed" else "")
        (copy / name).write_bytes(CHANGES[change]((first / f"{one.name}.csv").read_bytes()))
    found = read_recordings([first, copy])
    assert [one.name for one in found] == [f"{motion}_1" for motion in sorted(MOTIONS)]
    assert all("copy of it left out" in "".join(one.repairs) for one in found)


def test_a_copy_by_another_clock_is_one(drives):
    one = drives[0]
    later = replace(one, t_s=one.t_s + 1.7e9, truth_t_s=one.truth_t_s + 1.7e9)
    assert is_copy(one, later)
    assert is_copy(later, one)
    late = replace(later, truth_t_s=later.truth_t_s + 0.5)  # what was seen half a second later is another way
    assert not is_copy(one, late)
    assert not is_copy(late, one)


@pytest.mark.parametrize(
    ("rows", "place"),
    [(slice(0, 3), 0), (slice(100, 103), 1), (slice(-3, None), 2)],
    ids=["first", "in it", "last"],
)
def test_the_same_wheels_with_other_ground_truth_are_no_copy(drives, rows, place):
    one = drives[0]
    for off, alike in ((2e-3, False), (2e-4, True)):
        pose = one.truth_pose.copy()
        pose[rows, place] += off
        assert is_copy(one, replace(one, truth_pose=pose)) is alike
        assert is_copy(replace(one, truth_pose=pose), one) is alike


@pytest.mark.parametrize("column", ["wheel_angle_rad", "steering_rad"])
def test_other_wheels_with_the_same_ground_truth_are_no_copy(drives, column):
    one = drives[0]
    values = getattr(one, column).copy()
    values[50, 2] += 1e-4
    assert not is_copy(one, replace(one, **{column: values}))
    times_s = one.t_s.copy()
    times_s[50] += 1e-3
    assert not is_copy(one, replace(one, t_s=times_s))
    names = ("t_s", "wheel_angle_rad", "steering_rad", "wheel_rate_rad_s")
    assert not is_copy(one, replace(one, **{name: getattr(one, name)[:-1] for name in names}))


def test_a_copy_called_by_another_motion_is_none_either(tmp_path, drives):
    for name in ("line_x_1", "dance_7"):
        write_plain(tmp_path / f"{name}.csv", drives[0])
    write_plain(tmp_path / "line_x_2.csv", drives[1])
    assert [r.name for r in read_recordings([tmp_path])] == ["dance_7", "line_x_2"]


def test_an_export_beside_its_recording_is_a_copy(tmp_path, capsys):
    from hil.bench import open_bench
    from hil.recording.mcap_writer import McapRecorder

    path = tmp_path / "stand_1.mcap"
    bench = open_bench("emulated_floor")
    bench.add_sink(McapRecorder(path, bench.header(), lossless=True))
    with bench:
        bench.observe(2.0)
    assert main(["export", str(path)]) == 0
    (one,) = read_recordings([tmp_path])
    assert one.repairs == {f"copy of it left out, {path}": 1}


@pytest.mark.parametrize("rates_hz", [(100.0, 20.0), (10.0, 62.5)], ids=str)
def test_an_export_of_a_bag_with_noise_is_a_copy(tmp_path, capsys, rates_hz):
    """It holds the ground truth at the instants of the wheels, a part of the rows that the bag has."""
    topics, folder = tmp_path / "topics.toml", tmp_path / "bags"
    topics.write_text(perfect.MAPPING)
    for k in range(2):
        found = perfect.drive(truth_hz=rates_hz[0], wheel_hz=rates_hz[1], noise=2e-3, seed=k)
        perfect.write_bag(folder / f"curve_{k}", perfect.messages(found))
    named = ["--topics", topics]
    assert hil(capsys, "export", folder / "curve_1", *named)[0] == 0
    code, table, _ = hil(capsys, "evaluate", folder, *named)
    assert (code, table["recordings"]) == (0, 2)
    copy = [line for line in table["warnings"] if "copy of it left out" in line]
    assert [line.partition(":")[0] for line in copy] == ["curve_1"]


def test_a_calibration_knows_the_bags_it_was_fitted_to(tmp_path, capsys):
    """By the folder, by the storage file in it and by an export; another bag it was not fitted to."""
    topics, folder, out = tmp_path / "topics.toml", tmp_path / "bags", tmp_path / "c.toml"
    topics.write_text(perfect.MAPPING)
    for k in range(2):
        perfect.write_bag(folder / f"curve_{k}", perfect.messages(perfect.drive(seed=k)))
    held_out = tmp_path / "curve_7"
    perfect.write_bag(held_out, perfect.messages(perfect.drive(seed=7, sense=-1.0)))
    table = tmp_path / "table.csv"
    named = ["--topics", topics]
    assert hil(capsys, "export", folder / "curve_1", "--out", table, *named)[0] == 0
    words = ["--model", "exact", "--no-validation", "--out", out]
    assert hil(capsys, "calibrate", folder, *named, *words)[0] == 0
    kept = read_calibration(out).recordings
    storages = [next(p for p in sorted((folder / name).iterdir()) if p.suffix != ".yaml") for name in kept]
    digests = [[hashlib.sha256(path.read_bytes()).hexdigest()] for path in storages]
    assert [one["sha256"] for one in kept.values()] == digests

    def seen(*paths):
        return hil(capsys, "evaluate", *paths, *named, "--calibration", out)[1]["in_sample"]

    assert seen(folder)["names"] == ["curve_0", "curve_1"]
    assert seen(storages[1], held_out)["names"] == [storages[1].stem]
    assert seen(table)["names"] == ["table"]


def test_packed_and_plain_halves_of_one_run_get_one_statement(public_data, tmp_path):
    for half in ("odom_21.csv.gz", "abs_21.csv.gz"):
        shutil.copy(public_data / half, tmp_path / half)
    (tmp_path / "odom_21.csv").write_bytes(gzip.decompress((public_data / "odom_21.csv.gz").read_bytes()))
    (one,) = read_recordings([tmp_path])
    assert one.repairs == {f"copy of it left out, {tmp_path / 'odom_21.csv.gz'}": 1}
    lines = gzip.decompress((public_data / "abs_21.csv.gz").read_bytes()).splitlines(keepends=True)
    (tmp_path / "abs_21.csv").write_bytes(b"".join(lines[:1] + lines[1::2]))
    (one,) = read_recordings([tmp_path / "odom_21.csv"])
    assert one.sources == (str(tmp_path / "odom_21.csv"), str(tmp_path / "abs_21.csv"))
    assert len(one.truth_t_s) == pytest.approx(len(lines) / 2, abs=1)
