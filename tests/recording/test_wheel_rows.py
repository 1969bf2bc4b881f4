"""Wheel rows as loggers write them: held, one wheel at a time, columns apart, changed values only."""

from dataclasses import replace

import numpy as np
import perfect_robot as perfect
import pytest

from hil.calibration.evaluation import position_rmse, track
from hil.calibration.synthetic import hidden_robot, simulate
from hil.calibration.warnings import warnings_of
from hil.core.errors import DataError
from hil.datasets.cleaning import Log
from hil.datasets.plain_csv import read_plain, write_plain
from hil.datasets.read import read_recordings
from hil.datasets.wheel_log import build_recording
from hil.robot.kinematics import WheelGeometry

COUNT_RAD = 2.0 * np.pi / 4096.0
NOISE_M = np.sqrt(2.0) * 2e-4


def counts(values):
    return np.round(values / COUNT_RAD) * COUNT_RAD


def table(found):
    """Wheels at 100 Hz, with ground truth in the same rows: (n, 12)."""
    truth = [np.interp(found.t_s, found.truth_s, column) for column in found.pose.T]
    return np.column_stack([found.t_s, counts(found.phi), counts(found.delta), *truth])


def held(rows, period):
    """Wheels read every few rows, the last values repeated between."""
    out = rows.copy()
    out[:, 1:9] = rows[(np.arange(len(rows)) // period) * period, 1:9]
    return out


def one_by_one(rows):
    """One wheel read in each row, drive and steering, the last values of the others repeated."""
    out = rows.copy()
    for wheel in range(4):
        last = np.maximum((np.arange(len(rows)) - wheel) // 4 * 4 + wheel, 0)
        for column in (1 + wheel, 5 + wheel):
            out[:, column] = rows[last, column]
    return out


def apart(rows):
    """Drives, steering and ground truth in rows of their own, steering 4 ms later."""
    drives, steering, truth = rows[::2].copy(), rows[::2].copy(), rows.copy()
    drives[:, 5:], steering[:, 1:5], steering[:, 9:], truth[:, 1:9] = np.nan, np.nan, np.nan, np.nan
    steering[:, 0] += 4e-3
    steering[:, 5:9] = np.column_stack([np.interp(steering[:, 0], rows[:, 0], c) for c in rows.T[5:9]])
    truth[:, 0] += 1e-3
    truth[:, 9:] = np.column_stack([np.interp(truth[:, 0], rows[:, 0], c) for c in rows.T[9:]])
    every = np.vstack([drives, steering, truth])
    return every[np.argsort(every[:, 0], kind="stable")]


def changes_only(rows):
    out = rows.copy()
    out[1:, 1:][rows[1:, 1:] == rows[:-1, 1:]] = np.nan
    return out


def written(folder, rows):
    path = folder / "curve_1.csv"
    np.savetxt(path, rows, fmt="%.9g", delimiter=",", header=",".join(perfect.COLUMNS[:12]), comments="")
    path.write_text(path.read_text().replace("nan", ""))
    return read_plain(path)


WRITTEN = {
    "held at 20 Hz": lambda rows: held(rows, 5),
    "held at 10 Hz": lambda rows: held(rows, 10),
    "one by one": one_by_one,
    "apart": apart,
    "changes only": changes_only,
    "changes only, held at 20 Hz": lambda rows: changes_only(held(rows, 5)),
}


@pytest.mark.parametrize("how", WRITTEN)
def test_how_a_logger_writes_wheel_rows_changes_no_figure(tmp_path, how):
    """At 10 Hz, held, it had been 14 mm and "the ground truth moves earlier"."""
    rows = WRITTEN[how](table(perfect.drive(wheel_hz=100.0)))
    found = written(tmp_path, rows)
    assert position_rmse(track(found, WheelGeometry.nominal())) < 1.5 * NOISE_M
    assert not any("earlier" in line or "later" in line for line in warnings_of([found]))
    assert any(what in line for line in found.repairs for what in ("repeated", "rows of their own", "empty"))


def test_counters_that_wrap_are_interpolated_between_held_rows():
    rows = held(table(perfect.drive(wheel_hz=100.0)), 10)
    rows[:, 1:9] = np.angle(np.exp(1j * rows[:, 1:9]))
    found = build_recording("curve", Log(rows[:, 0], rows[:, 1:9]), Log(rows[:, 0], rows[:, 9:]))
    assert position_rmse(track(found, WheelGeometry.nominal())) < 1.5 * NOISE_M


def test_wheels_that_stand_keep_their_rows():
    """Two stops in between: nothing is interpolated across a rest, nor said of a log that holds nothing."""
    rows = table(perfect.drive(wheel_hz=100.0))
    middle = len(rows) // 2
    rest = np.repeat(rows[middle : middle + 1], 300, axis=0)
    rows = np.vstack([rows[:middle], rest, rows[middle:]])
    rows[:, 0] = np.arange(len(rows)) * 0.01
    whole = build_recording("curve", Log(rows[:, 0], rows[:, 1:9]), Log(rows[:, 0], rows[:, 9:]))
    assert len(whole.t_s) == len(rows)
    assert not any("repeated" in what and "wheel" in what for what in whole.repairs)
    slow = held(rows, 5)
    found = build_recording("curve", Log(slow[:, 0], slow[:, 1:9]), Log(slow[:, 0], slow[:, 9:]))
    at_rest = (found.t_s > rows[middle, 0] + 0.2) & (found.t_s < rows[middle + 300, 0] - 0.2)
    assert np.count_nonzero(at_rest) > 200
    assert np.ptp(found.wheel_angle_rad[at_rest], axis=0).max() < 1e-12


def test_a_gap_in_a_table_of_changes_is_no_rest(tmp_path):
    """The wheels have no row for a second while they roll: they had not stood there."""
    rows = changes_only(table(perfect.drive(wheel_hz=100.0)))
    lost = (rows[:, 0] > 6.0) & (rows[:, 0] < 7.0)
    rows[lost, 1:9] = np.nan
    found = written(tmp_path, rows)
    inside = (found.t_s > 6.05) & (found.t_s < 6.95)
    steps = np.abs(np.diff(np.interp(np.arange(5.5, 7.5, 0.1), found.t_s, found.wheel_angle_rad[:, 0])))
    assert not inside.any() or np.max(steps) < 3.0 * np.median(steps)


def test_columns_that_have_no_row_are_still_named():
    rows = table(perfect.drive(wheel_hz=100.0))
    rows[:, 8] = np.nan
    with pytest.raises(DataError, match=r"only 0 usable wheel rows \(delta4 holds no number"):
        build_recording("curve", Log(rows[:, 0], rows[:, 1:9]), Log(rows[:, 0], rows[:, 9:]))


def test_steering_in_messages_of_its_own_may_lie_on_both_sides_of_the_wrap(tmp_path):
    """A bag of modules half a turn round, driven backwards; its steering is interpolated to the drives."""
    found = perfect.drive()
    flipped = replace(found, phi=-found.phi, delta=np.angle(np.exp(1j * (found.delta + np.pi))))
    messages = [one for one in perfect.messages(flipped) if one[0] != "/wheels"]
    for k, t in enumerate(flipped.t_s):
        for names, values, late_s in (
            (perfect.DRIVE, flipped.phi[k], 0.0),
            (perfect.STEER, flipped.delta[k], 1e-4),
        ):
            joints = perfect.STORE.types[perfect.JOINT](
                perfect.header(t + late_s), names, values.copy(), np.array([]), np.array([])
            )
            messages.append(("/wheels", t + late_s, joints))
    bag = perfect.write_bag(tmp_path / "curve_1", sorted(messages, key=lambda one: one[1]))
    topics = tmp_path / "topics.toml"
    topics.write_text(perfect.MAPPING)
    (one,) = read_recordings([bag], topics=topics)
    assert len(one.t_s) == len(found.t_s)
    assert position_rmse(track(one, WheelGeometry.nominal())) < 1.2 * NOISE_M


def test_poses_lost_at_rest_are_a_gap_and_no_column_of_changed_values_only(tmp_path):
    run = simulate(hidden_robot(1), "line_x", "line_x_1", np.random.default_rng(1))
    file = tmp_path / "line_x_1.csv"
    write_plain(file, run)
    header, *rows = file.read_text().splitlines()
    names = header.split(",")
    for k in range(len(rows) - 40, len(rows) - 20):
        cells = rows[k].split(",")
        cells = ["" if name in ("x", "y", "theta") else cell for name, cell in zip(names, cells, strict=True)]
        rows[k] = ",".join(cells)
    file.write_text("\n".join([header, *rows]) + "\n")
    (found,) = read_recordings([file])
    assert list(found.repairs) == ["ground-truth gaps over 0.1 s, in which nothing is compared"]
