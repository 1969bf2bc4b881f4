"""Files of Motive, QTM, Vicon, TUM and EuRoC: named, read as ground truth, joined with a wheel log."""

import json
import re
from dataclasses import replace

import numpy as np
import perfect_robot as perfect
import pytest

from hil.calibration.evaluation import position_rmse, track
from hil.cli import main
from hil.core.errors import DataError, UsageError
from hil.datasets.plain_csv import read_plain
from hil.datasets.truth_files import TruthFile
from hil.robot.kinematics import WheelGeometry

NOISE_M = np.sqrt(2.0) * 2e-4
FIRST_NS = 1_700_000_000_123_456_789


def quaternion(pose):
    """Of a heading about z: x, y, z, w."""
    half = 0.5 * pose[2]
    return 0.0, 0.0, np.sin(half), np.cos(half)


def motive(found, units="Meters", scale=1.0):
    """Y up, so that y of the floor is -z; two bodies, markers, occlusions."""
    kinds = ["Rigid Body"] * 8 + ["Rigid Body Marker"] * 3 + ["Rigid Body"] * 8
    names = ["Cart"] * 8 + ["Cart:Marker 001"] * 3 + ["Robot"] * 8
    parts = ["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]
    axes = ["X", "Y", "Z", "W", "X", "Y", "Z", ""]
    lines = [
        "Format Version,1.23,Take Name,Take 1,Take Notes,,Capture Frame Rate,100.000000,Export Frame Rate,"
        "100.000000,Capture Start Time,2024-05-03 12.00.00.000 PM,Capture Start Frame,0,Total Frames in Take,"
        f"{len(found.pose)},Total Exported Frames,{len(found.pose)},Rotation Type,Quaternion,Length Units,"
        f"{units},Coordinate Space,Global",
        "",
        ",".join(["", "Type", *kinds]),
        ",".join(["", "Name", *names]),
        ",".join(["", "ID", *(['"1"'] * len(kinds))]),
        ",".join(["", "", *parts, *(["Position"] * 3), *parts]),
        ",".join(["Frame", "Time (Seconds)", *axes, "X", "Y", "Z", *axes]),
    ]
    for k, (t, pose) in enumerate(zip(found.truth_s, found.pose, strict=True)):
        _, _, z, w = quaternion(pose)
        robot = [0.0, z, 0.0, w, scale * pose[0], scale * 0.08, -scale * pose[1], 2e-4]
        cells = [""] * 8 if k % 100 == 7 else [f"{v:.6f}" for v in robot]
        lines.append(",".join([str(k), f"{t:.6f}", *["0.5"] * 11, *cells]))
    return "\n".join(lines) + "\n"


def qtm(found):
    names = ["X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{k}]" for k in range(9))]
    lines = [
        f"NO_OF_FRAMES\t{len(found.pose)}",
        "NO_OF_CAMERAS\t8",
        "NO_OF_BODIES\t1",
        "FREQUENCY\t100",
        "DESCRIPTION\t--",
        "TIME_STAMP\t2024-05-03, 12:00:00.000\t1234.5",
        "DATA_INCLUDED\t6D",
        "BODY_NAMES\tRobot",
        "\t".join(["Frame", "Time", *names]),
    ]
    for k, (t, (x, y, theta)) in enumerate(zip(found.truth_s, found.pose, strict=True), start=1):
        c, s = np.cos(theta), np.sin(theta)
        row = [1e3 * x, 1e3 * y, 80.0, 0.0, 0.0, np.degrees(theta), 0.2, c, s, 0.0, -s, c, 0.0, 0.0, 0.0, 1.0]
        lost = [0.0] * 16
        lines.append("\t".join([str(k), f"{t:.5f}", *(f"{v:.6f}" for v in (lost if k % 90 == 0 else row))]))
    return "\n".join(lines) + "\n"


def vicon(found, unit="rad"):
    lines = ["Segments", "100", ",,Robot:Robot,,,,,", "Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ"]
    lines.append(f",,{unit},{unit},{unit},mm,mm,mm")
    scale = 1.0 if unit == "rad" else 180.0 / np.pi
    for t, (x, y, theta) in zip(found.truth_s, found.pose, strict=True):
        turn = scale * np.angle(np.exp(1j * theta))
        lines.append(f"{t * 100.0:.3f},0,0,0,{turn:.7g},{1e3 * x:.6g},{1e3 * y:.6g},80")
    return "\n".join(lines) + "\n\nTrajectories\n100\n"


def tum(found):
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    for t, pose in zip(found.truth_s, found.pose, strict=True):
        lines.append(" ".join(f"{v:.9f}" for v in (t, *pose[:2], 0.08, *quaternion(pose))))
    return "\n".join(lines) + "\n"


def euroc(found):
    names = [f"p_RS_R_{a} [m]" for a in "xyz"] + [f"q_RS_{a} []" for a in "wxyz"]
    lines = ["#timestamp [ns]," + ",".join(names)]
    for t, pose in zip(found.truth_s, found.pose, strict=True):
        x, y, z, w = quaternion(pose)
        values = [*pose[:2], 0.08, w, x, y, z]
        lines.append(f"{FIRST_NS + round(1e9 * t)}," + ",".join(f"{v:.9f}" for v in values))
    return "\n".join(lines) + "\n"


FILES = {"Motive CSV": motive, "QTM TSV": qtm, "Vicon CSV": vicon, "TUM trajectory": tum, "EuRoC": euroc}


def wheel_log(folder, found, name="curve_1.csv"):
    path = folder / name
    rows = np.column_stack([found.t_s, found.phi, found.delta])
    np.savetxt(path, rows, fmt="%.9f", delimiter=",", header=",".join(perfect.COLUMNS[:9]), comments="")
    return path


def given(path, **options):
    return TruthFile(path, body="Robot" if "Robot" in path.read_text() else None, **options)


@pytest.mark.parametrize("kind", FILES)
def test_ground_truth_of_a_file_joins_a_wheel_log(tmp_path, kind):
    found = perfect.drive()
    if kind == "EuRoC":
        found = replace(found, t_s=found.t_s + 1e-9 * FIRST_NS)
    path = tmp_path / "take"
    path.write_text(FILES[kind](perfect.drive()))
    log = wheel_log(tmp_path, found)
    one = read_plain(log, truth=given(path))
    assert position_rmse(track(one, WheelGeometry.nominal())) < 1.2 * NOISE_M
    assert one.sources == (str(log), str(path))
    assert len(set(one.sha256)) == 2
    assert one.repairs == {}


@pytest.mark.parametrize("kind", FILES)
def test_a_file_of_ground_truth_in_place_of_a_wheel_log_is_named(tmp_path, capsys, kind):
    path = tmp_path / "take_1.csv"
    path.write_text(FILES[kind](perfect.drive()))
    for command in ("evaluate", "calibrate", "replay", "tune"):
        assert main([command, str(path)]) == 2
        said = capsys.readouterr().err
        assert re.search(rf"take_1\.csv: is a {kind}.*: it holds poses, and no wheel angles.*--truth", said)


@pytest.mark.parametrize("later_s", [-3.21, 12.345, 1.7e9])
def test_a_clock_that_begins_elsewhere_is_said_or_fitted(tmp_path, later_s):
    found = perfect.drive()
    path = tmp_path / "take.csv"
    path.write_text(vicon(found, unit="deg"))
    log = wheel_log(tmp_path, replace(found, t_s=found.t_s + later_s))
    if abs(later_s) > 100.0:
        with pytest.raises(DataError, match=r"share less than a second.*--truth-offset fit"):
            read_plain(log, truth=given(path))
    one = read_plain(log, truth=given(path, fitted=True))
    shift_s = float(next(re.search(r"by (\S+) s fitted", what) for what in one.repairs)[1])
    assert shift_s == pytest.approx(later_s, abs=5e-3)
    assert position_rmse(track(one, WheelGeometry.nominal())) < 2.0 * NOISE_M
    again = read_plain(log, truth=given(path, offset_s=later_s))
    assert position_rmse(track(again, WheelGeometry.nominal())) < 1.2 * NOISE_M


def test_a_take_of_another_drive_fits_no_shift(tmp_path):
    path = tmp_path / "take.csv"
    still = perfect.drive()
    path.write_text(vicon(still.truth_where(still.truth_s < 1.4)))
    with pytest.raises(DataError, match=r"take\.csv: no shift makes its speed like that of the wheels"):
        read_plain(wheel_log(tmp_path, still), truth=given(path, fitted=True))


def test_commands_join_a_folder_of_logs_with_a_folder_of_takes(tmp_path, capsys):
    (tmp_path / "logs").mkdir(), (tmp_path / "takes").mkdir()
    for k in range(2):
        found = perfect.drive(seed=k, sense=(-1.0) ** k)
        wheel_log(tmp_path / "logs", found, f"curve{k}_1.csv")
        (tmp_path / "takes" / f"curve{k}_1.tsv").write_text(qtm(found))
    joined = [str(tmp_path / "logs"), "--truth", str(tmp_path / "takes"), "--json"]
    assert main(["evaluate", *joined]) == 0
    assert json.loads(capsys.readouterr().out)["mean"]["rmse_position_m"] < 1.2 * NOISE_M
    (tmp_path / "takes" / "curve1_1.tsv").unlink()
    assert main(["evaluate", *joined]) == 2
    assert "holds 0 files of the name curve1_1" in capsys.readouterr().err
    first = str(tmp_path / "logs" / "curve0_1.csv")
    assert (
        main(["replay", first, "--truth", str(tmp_path / "takes"), "--estimator", "odometry", "--json"]) == 0
    )
    odometry = json.loads(capsys.readouterr().out)["estimators"]["odometry"]
    assert odometry["rmse_position_m"] < 1.5 * NOISE_M


def test_units_bodies_and_settings_of_an_export_count(tmp_path):
    found = perfect.drive()
    log, path = wheel_log(tmp_path, found), tmp_path / "take.csv"
    path.write_text(motive(found, "Millimeters", 1e3))
    assert position_rmse(track(read_plain(log, truth=given(path)), WheelGeometry.nominal())) < 1.2 * NOISE_M
    with pytest.raises(UsageError, match=r"holds 2 bodies \(Cart, Robot\).*--truth-body"):
        read_plain(log, truth=TruthFile(path))
    with pytest.raises(UsageError, match=r"no body 'Rover'.*Cart, Robot"):
        read_plain(log, truth=TruthFile(path, body="Rover"))
    for change, said in (
        (("Quaternion", "XYZ"), "Rotation Type XYZ; expected Quaternion"),
        (("Global", "Local"), "Coordinate Space Local"),
        (("Millimeters", "Furlongs"), "unit 'Furlongs'"),
        (("Rigid Body", "Marker"), "without rigid bodies"),
    ):
        path.write_text(motive(found, "Millimeters", 1e3).replace(*change))
        with pytest.raises(DataError, match=said):
            read_plain(log, truth=TruthFile(path, body="Robot"))


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_the_plane_is_that_in_which_the_body_moves(tmp_path, up):
    """Rows of a TUM file whose frame has another axis normal to the surface, as on a wall."""
    found = perfect.drive()
    order = {"z": (0, 1, 2), "x": (2, 0, 1), "y": (1, 2, 0)}[up]
    lines = []
    for t, pose in zip(found.truth_s, found.pose, strict=True):
        x, y, z, w = quaternion(pose)
        at, turned = np.array([*pose[:2], 0.08])[[*order]], np.array([x, y, z])[[*order]]
        lines.append(" ".join(f"{v:.9f}" for v in (t, *at, *turned, w)))
    path = tmp_path / "take.txt"
    path.write_text("\n".join(lines) + "\n")
    one = read_plain(wheel_log(tmp_path, found), truth=TruthFile(path))
    turned = one.truth_pose[:, 2] - one.truth_pose[0, 2]
    np.testing.assert_allclose(turned, found.pose[:, 2] - found.pose[0, 2], atol=1e-6)
    assert any(f"normal to {up}" in what for what in one.repairs) == (up != "z")
